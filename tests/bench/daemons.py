"""What the supervisor makes of daemons without a part of what keeps the robot safe, on a robot
without holding brakes and on one that has them. With ``--write`` the table goes into
docs/supervisor_measured.md."""

from __future__ import annotations

from collections.abc import Iterator

import click
import pytest

from tests.bench.pages import Marks, today
from tests.mutated_daemons import BARE, BRAKED, DAEMONS, Stopped, played
from tonus.config.loader import HERE

_PAGE = HERE.parent / "docs" / "supervisor_measured.md"
HEAD = [
    "| what is wrong with the daemon | found as | after | drives stop after | peak m/s until then "
    "| peak N | bounds broken | peak m/s after it | bounds broken |",
    "|---" * 9 + "|",
]
ROBOTS = {BARE: "without brakes", BRAKED: "with a holding brake on every motor"}


def row(name: str, found: Stopped) -> str:
    by = ", ".join(f"SUP-{number}" for number in sorted(found.requirements)) or "nothing"
    broken, after = (
        ", ".join(f"`{each}`" for each in sorted(every)) or "none"
        for every in (found.broken, found.broken_after)
    )
    began, later = f"{found.speed:.2f}", f"{found.speed_after:.2f}"
    return (
        f"| {name} | {by} | {found.found_ms:.0f} ms | {found.stopped_ms:.0f} ms "
        f"| {began} | {found.tension:.0f} | {broken} | {later} | {after} |"
    )


def table(robot: str) -> Iterator[str]:
    """Its lines."""
    yield f"{len(DAEMONS)} daemons, {ROBOTS[robot]}, {today()}."
    yield ""
    yield from HEAD
    for name in DAEMONS:
        yield row(name, played(name, pytest.MonkeyPatch(), robot))


@click.command()
@click.option(
    "--write", "written", is_flag=True, help="Put the tables into docs/supervisor_measured.md."
)
def main(written: bool) -> None:
    """Play each daemon of tests/mutated_daemons.py on each robot."""
    tables: list[str] = []
    for robot in ROBOTS:
        lines: list[str] = []
        for line in table(robot):
            click.echo(line)
            lines.append(line)
        tables.append("\n".join(lines))
    if written:
        Marks(_PAGE, "daemons").fill("\n\n".join(tables))


if __name__ == "__main__":
    main()
