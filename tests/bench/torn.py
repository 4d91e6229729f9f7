"""Every cable torn at each of 27 poses, at rest and in motion: how fast the platform gets, and what
the robot takes it for. With ``--write`` it goes into docs/stop_measured.md and docs/torn.png."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any

import click
import numpy as np
import yaml
from matplotlib.figure import Figure as Picture
from rich.console import Console

from tests.bench.pages import Marks, today
from tests.torn import CABLES, GRID, LATER, MOTIONS, Motion, Stopped, Torn
from tonus.config.loader import HERE, load_bounds
from tonus.tools.report import style

_DOCS = HERE.parent / "docs"
_UPPER = 4
"""cables 0 to 3 are the upper ones"""
GROUPS = (("upper, 0 to 3", range(_UPPER)), ("lower, 4 to 7", range(_UPPER, CABLES)))
Optima = dict[tuple[int, tuple[float, ...], str], float]
"""least peak speed (m/s) by cable, pose and motion"""


def optima(path: Path) -> Optima:
    """The offline optimum's table, as far as there is one."""
    if not path.is_file():
        return {}
    table: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
    return {
        (tear["cable"], tuple(tear["position"]), motion): tear[motion]["speed"]
        for tear, motion in product(table["tears"], MOTIONS)
        if tear.get(motion) is not None
    }


def study(poses: int) -> Iterator[Stopped]:
    """All cases at so many poses of the grid."""
    for home in GRID[:poses]:
        robot = Torn(home)
        for cable in range(CABLES):
            yield from robot.cases(cable)


def ratio(case: Stopped, least: Optima) -> float:
    """Peak speed over the optimum's; not a number where that is not known. Who moves cannot be
    slower than at the break."""
    return case.peak_speed / least.get((case.cable, case.home, case.motion), np.nan)


def _spread(values: Sequence[float], form: str) -> str:
    return f"{np.median(values):{form}} | {np.max(values):{form}}"


def table(cases: Sequence[Stopped], least: Optima) -> list[str]:
    """Markdown, a row for each half of the cables and each motion."""
    limit = load_bounds().speed
    lines = [
        "| torn cable | motion | cases | peak speed m/s, median | worst "
        f"| times the optimum, median | worst | over {limit:g} m/s | from {LATER:g} s on, worst "
        "| peak tension N, worst | found after ms, median | worst | `CABLE_TORN` and where "
        "| cable given up | at rest |",
        "|---" * 15 + "|",
    ]
    for (name, cables), motion in product(GROUPS, MOTIONS):
        chosen = [case for case in cases if case.cable in cables and case.motion == motion]
        if not chosen:
            continue
        found = [
            1e3 * (np.inf if each.found_after is None else each.found_after) for each in chosen
        ]
        ratios = [ratio(each, least) for each in chosen]
        lines.append(
            f"| {name} | {motion} | {len(chosen)} "
            f"| {_spread([each.peak_speed for each in chosen], '.2f')} "
            f"| {_spread(ratios, '.1f')} "
            f"| {sum(each.peak_speed > limit for each in chosen)} "
            f"| {max(each.later_speed for each in chosen):.2f} "
            f"| {max(each.peak_tension for each in chosen):.0f} | {_spread(found, '.0f')} "
            f"| {_share([each.named for each in chosen])} "
            f"| {_share([each.cable in each.given_up for each in chosen])} "
            f"| {_share([each.at_rest for each in chosen])} |"
        )
    return lines


def _share(kept: Sequence[bool]) -> str:
    return f"{100.0 * np.mean(kept):.0f} %"


def picture(cases: Sequence[Stopped], least: Optima, path: Path) -> None:
    """Peak speed of every case beside its optimum, a panel for each motion."""
    figure = Picture(figsize=(10.0, 4.2), layout="constrained")
    limit = load_bounds().speed
    for panel, motion in zip(figure.subplots(1, len(MOTIONS), sharey=True), MOTIONS, strict=True):
        for cable in range(CABLES):
            chosen = [case for case in cases if case.cable == cable and case.motion == motion]
            spread = np.linspace(-0.3, 0.3, len(chosen))
            best = [least.get((cable, case.home, motion), np.nan) for case in chosen]
            panel.plot(cable + spread, best, "_", color=style.GREEN, markersize=5)
            peaks = [case.peak_speed for case in chosen]
            panel.plot(cable + spread, peaks, ".", color=style.BLUE, markersize=4)
        panel.axhline(limit, color="0.25", linestyle=style.DASHES, linewidth=1.0)
        panel.set(title=_TITLES[motion], xlabel="torn cable", xticks=range(CABLES))
        panel.grid(color="0.9", linewidth=0.6)
    first = figure.axes[0]
    first.set(ylabel="peak speed, m/s", ylim=(0.0, None))
    for label, mark, colour in (("measured", ".", style.BLUE), ("optimum", "_", style.GREEN)):
        first.plot([], [], mark, color=colour, label=label)
    first.plot([], [], color="0.25", linestyle=style.DASHES, linewidth=1.0, label="bound")
    first.legend(loc="upper right", fontsize=8, frameon=False)
    figure.savefig(path, dpi=110)


_TITLES: dict[Motion, str] = {
    "rest": "at rest",
    "towards": "moving towards its anchor",
    "away": "moving away from it",
}


def describe(case: Stopped, least: Optima) -> str:
    """One line."""
    found = "never" if case.found_after is None else f"{1e3 * case.found_after:.0f} ms"
    return (
        f"{case.home} cable {case.cable} {case.motion:7} {case.peak_speed:.2f} m/s at "
        f"{1e3 * case.peak_at:.0f} ms, {ratio(case, least):.1f} x, later {case.later_speed:.2f}, "
        f"{case.peak_tension:.0f} N, {case.fault} {case.where} after {found}, {case.mode}, "
        f"{'at rest' if case.at_rest else 'NOT at rest'}"
    )


@click.command()
@click.option("--poses", type=click.IntRange(1, len(GRID)), default=len(GRID), show_default=True)
@click.option("--from", "source", type=Path, help="Read these JSON lines instead of measuring.")
@click.option("--out", type=Path, default=Path("out/torn.jsonl"), show_default=True)
@click.option("--least", type=Path, default=HERE / "least_stop.yaml", help="The optimum's table.")
@click.option("--write", "written", is_flag=True, help="Put table and figure into docs.")
def main(poses: int, source: Path | None, out: Path, least: Path, *, written: bool) -> None:
    """Tear every cable and say how the robot stops."""
    console = Console(highlight=False, soft_wrap=True)
    known = optima(least)
    cases: list[Stopped] = []
    if source is not None:
        for line in source.read_text(encoding="utf-8").splitlines():
            row = json.loads(line)
            row |= {name: tuple(row[name]) for name in ("home", "rest", "given_up")}
            cases.append(Stopped(**row))
    else:
        out.parent.mkdir(parents=True, exist_ok=True)
        with out.open("w", encoding="utf-8") as lines:
            for case in study(poses):
                lines.write(json.dumps(asdict(case)) + "\n")
                lines.flush()
                console.print(describe(case, known))
                cases.append(case)
    rows = table(cases, known)
    console.print("\n".join(rows))
    if written:
        picture(cases, known, _DOCS / "torn.png")
        text = [f"{len(cases)} cases, {today()}.", "", *rows, "", "![Peak speeds](torn.png)"]
        Marks(_DOCS / "stop_measured.md", "torn").fill("\n".join(text))
    sys.exit(0 if all(case.at_rest for case in cases) else 1)


if __name__ == "__main__":
    main()
