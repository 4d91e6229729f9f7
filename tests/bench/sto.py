"""Safe torque off of every drive and of each one, with holding brakes and without, and with each
brake that fails: how far and how fast the platform falls. With ``--write`` the result goes into
docs/sto.md and docs/sto.png."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from itertools import product
from pathlib import Path

import click
import numpy as np
from matplotlib.figure import Figure as Picture
from rich.console import Console

from tests.bench.pages import Marks, today
from tests.torque_off import MOTIONS, PLACES, Fallen, Motion, cases, play
from tonus.config import load
from tonus.config.loader import HERE, load_bounds
from tonus.tools.report import style

_DOCS = HERE.parent / "docs"
_WHICH = (
    "all, no brakes",
    "all, brakes",
    "all, one brake failing",
    "one, no brakes",
    "one, brakes",
)
HEAD = [
    "| torque off | place | motion | cases | drop mm, worst | of mm to the cradle "
    "| peak speed m/s, worst | free fall ms, worst | peak tension N, worst "
    "| at rest after s, worst | ends in |",
    "|---" * 11 + "|",
]


def which(case: Fallen) -> str:
    """The row of the table that a case belongs to."""
    axes = "all" if case.axis is None else "one"
    if case.failed is not None:
        return f"{axes}, one brake failing"
    return f"{axes}, {'brakes' if case.brakes else 'no brakes'}"


def study(places: Sequence[str], motions: Sequence[Motion]) -> Iterator[Fallen]:
    """Every case of these places and motions."""
    brake = load("config/braked.yaml")[0].robot.brake
    assert brake is not None
    for place, motion, fitted in product(places, motions, (None, brake)):
        yield from play(place, motion, fitted, list(cases(place, motion, brakes=bool(fitted))))


def rows(found: Sequence[Fallen]) -> Iterator[str]:
    """Of the table, one for each kind of case that there is."""
    for kind, place, motion in product(_WHICH, PLACES, MOTIONS):
        group = [
            case
            for case in found
            if (which(case), case.place, case.motion) == (kind, place, motion)
        ]
        if group:
            yield _row(kind, place, motion, group)


def _row(kind: str, place: str, motion: Motion, group: Sequence[Fallen]) -> str:
    ends = sorted({f"{case.state}, `{case.reason}`" for case in group})
    moving = sum(not case.at_rest for case in group)
    return (
        f"| {kind} | {place} | {motion} | {len(group)} "
        f"| {1e3 * max(case.drop for case in group):.0f} "
        f"| {1e3 * min(case.cradle for case in group):.0f} "
        f"| {max(case.peak_speed for case in group):.2f} "
        f"| {1e3 * max(case.free_fall for case in group):.0f} "
        f"| {max(case.peak_tension for case in group):.0f} "
        f"| {max(case.seconds for case in group):.1f}{f', {moving} moving' if moving else ''} "
        f"| {'; '.join(ends)} |"
    )


def picture(found: Sequence[Fallen], path: Path) -> None:
    """Drop and peak speed of every case, a column for each kind."""
    figure = Picture(figsize=(10.0, 4.6), layout="constrained")
    drops, speeds = figure.subplots(1, 2)
    colours = {"rest": style.BLUE, "sinking": style.VERMILION}
    for column, kind in enumerate(_WHICH):
        for side, motion in ((-0.15, "rest"), (0.15, "sinking")):
            group = [each for each in found if which(each) == kind and each.motion == motion]
            at = column + side + np.linspace(-0.1, 0.1, len(group))
            colour = colours[motion]
            drops.plot(at, [1e3 * each.drop for each in group], ".", color=colour, markersize=5)
            speeds.plot(at, [each.peak_speed for each in group], ".", color=colour, markersize=5)
    labels = [kind.replace(", ", ",\n") for kind in _WHICH]
    for panel, title in ((drops, "drop, mm"), (speeds, "peak speed, m/s")):
        panel.set(title=title, xticks=range(len(_WHICH)), xticklabels=labels, ylim=(0.0, None))
        panel.tick_params(axis="x", labelsize=8)
        panel.grid(color="0.9", linewidth=0.6)
    bound = load_bounds().speed
    speeds.axhline(bound, color="0.25", linestyle=style.DASHES, linewidth=1.0, label="bound")
    for motion, colour in colours.items():
        speeds.plot([], [], ".", color=colour, label=motion)
    speeds.legend(fontsize=8, frameon=False)
    figure.savefig(path, dpi=110)


def describe(case: Fallen) -> str:
    """One line."""
    failed = "" if case.failed is None else f", brake {case.failed} fails"
    axis = "all" if case.axis is None else f"axis {case.axis}"
    return (
        f"{case.place}, {case.motion}: {axis}, {'brakes' if case.brakes else 'no brakes'}{failed}: "
        f"{1e3 * case.drop:.0f} of {1e3 * case.cradle:.0f} mm, {case.peak_speed:.2f} m/s, "
        f"{case.peak_tension:.0f} N, {case.state} {case.reason}, "
        f"{'at rest' if case.at_rest else 'NOT at rest'} after {case.seconds:.1f} s"
    )


def _measured(
    console: Console, out: Path, places: Sequence[str], motions: Sequence[Motion]
) -> list[Fallen]:
    found: list[Fallen] = []
    out.parent.mkdir(parents=True, exist_ok=True)
    with out.open("w", encoding="utf-8") as lines:
        for case in study(places, motions):
            lines.write(json.dumps(asdict(case)) + "\n")
            lines.flush()
            console.print(describe(case))
            found.append(case)
    return found


@click.command()
@click.option(
    "--places", type=click.IntRange(1, len(PLACES)), default=len(PLACES), show_default=True
)
@click.option("--motion", type=click.Choice(MOTIONS), help="Only this one.")
@click.option("--from", "source", type=Path, help="Read these JSON lines instead of measuring.")
@click.option("--out", type=Path, default=Path("out/sto.jsonl"), show_default=True)
@click.option("--write", "written", is_flag=True, help="Put table and figure into docs.")
def main(
    places: int, motion: Motion | None, source: Path | None, out: Path, *, written: bool
) -> None:
    """Take the drives' torque and say how the platform falls."""
    console = Console(highlight=False, soft_wrap=True, markup=False)
    if source is not None:
        lines = source.read_text(encoding="utf-8").splitlines()
        found = [Fallen(**json.loads(line)) for line in lines]
    else:
        found = _measured(console, out, list(PLACES)[:places], (motion,) if motion else MOTIONS)
    table = [*HEAD, *rows(found)]
    console.print("\n".join(table))
    if written:
        picture(found, _DOCS / "sto.png")
        text = [
            f"{len(found)} cases, {today()}.",
            "",
            *table,
            "",
            "![Drop and peak speed](sto.png)",
        ]
        Marks(_DOCS / "sto.md", "sto").fill("\n".join(text))
    sys.exit(0 if all(case.state == "FAULT" for case in found) else 1)


if __name__ == "__main__":
    main()
