"""What the supervisor makes of daemons without a part of what keeps the robot safe. With
``--write`` the table goes into docs/supervisor.md."""

from __future__ import annotations

from collections.abc import Iterator

import click
import pytest

from tests.bench.pages import Marks, today
from tests.mutated_daemons import DAEMONS, Stopped, played
from tonus.config.loader import HERE

_PAGE = HERE.parent / "docs" / "supervisor.md"
HEAD = [
    "| what is wrong with the daemon | found as | after | drives stop after | peak m/s until then "
    "| peak N | bounds broken | peak m/s after it | bounds broken |",
    "|---" * 9 + "|",
]


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


def rows() -> Iterator[str]:
    for name in DAEMONS:
        yield row(name, played(name, pytest.MonkeyPatch()))


@click.command()
@click.option("--write", "written", is_flag=True, help="Put the table into docs/supervisor.md.")
def main(written: bool) -> None:
    """Play each daemon of tests/mutated_daemons.py."""
    lines = list(HEAD)
    for line in rows():
        click.echo(line)
        lines.append(line)
    if written:
        text = f"{len(lines) - len(HEAD)} daemons, {today()}.\n\n" + "\n".join(lines)
        Marks(_PAGE, "daemons").fill(text)


if __name__ == "__main__":
    main()
