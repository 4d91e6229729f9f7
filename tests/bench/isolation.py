"""Every fault of cables, drums, motors and sensors, at rest and in motion: what it is taken for,
how soon, and what follows. With ``--write`` the table goes into docs/stop_measured.md."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import click
from rich.console import Console

from tests.bench.pages import Marks, today
from tests.isolated import BROKEN, Broken, play
from tests.torn import Stopped, Torn
from tonus.config.loader import HERE

HOME = (0.0, 0.0, 0.0)
CABLES = (0, 5)
"""an upper one and a lower one"""
HEAD = [
    "| fault | size | cable | motion | tension N | taken for | right | found after | peak m/s "
    "| peak N | ends |",
    "|---" * 11 + "|",
]


def study() -> Iterator[tuple[Broken, Stopped]]:
    robot = Torn(HOME)
    for broken in BROKEN:
        for cable in CABLES:
            for case in play(robot, broken, cable):
                yield broken, case


def row(broken: Broken, case: Stopped) -> str:
    """Of the table. Cables and places count from 0."""
    taken, found, right = "nothing", "–", "no"
    if case.found_after is not None:
        taken = f"`{case.fault}`" + (f" {case.where}" if case.where >= 0 else "")
        found = f"{1e3 * case.found_after:.0f} ms"
        right = "yes" if broken.right(case) else "place" if case.where == case.cable else "no"
    end = "goes on" if case.mode == "NONE" else case.mode
    if case.mode != "NONE" and case.ended_after is None:
        end += ", not over in 8 s"
    if not case.at_rest and case.ended_after is not None:
        end += ", moving"
    return (
        f"| `{broken.kind}` | {broken.size} | {case.cable} | {case.motion} "
        f"| {case.tension_at_break:.0f} | {taken} | {right} | {found} | {case.peak_speed:.2f} "
        f"| {case.peak_tension:.0f} | {end} |"
    )


@click.command()
@click.option("--out", type=Path, default=Path("out/isolation.jsonl"), show_default=True)
@click.option("--write", "written", is_flag=True, help="Put the table into docs/stop_measured.md.")
def main(out: Path, *, written: bool) -> None:
    """Break what can break, one at a time."""
    console = Console(highlight=False, soft_wrap=True, markup=False)
    out.parent.mkdir(parents=True, exist_ok=True)
    rows = list(HEAD)
    with out.open("w", encoding="utf-8") as lines:
        for broken, case in study():
            line = {"kind": broken.kind, "size": broken.size, **asdict(case)}
            lines.write(json.dumps(line) + "\n")
            lines.flush()
            rows.append(row(broken, case))
            console.print(rows[-1])
    if written:
        text = "\n".join([f"At the centre, {today()}.", "", *rows])
        Marks(HERE.parent / "docs" / "stop_measured.md", "isolation").fill(text)


if __name__ == "__main__":
    main()
