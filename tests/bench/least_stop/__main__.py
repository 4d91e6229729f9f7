"""Solve what is not solved yet, then write the table and the figure."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from tests.bench.least_stop import figure, table
from tests.bench.least_stop.cases import MOTIONS
from tests.bench.least_stop.solve import STARTS, Solver
from tonus.config import load
from tonus.config.loader import load_least_stops

OUT = Path("out/least_stop")
TABLE = Path("config/least_stop.yaml")
FIGURE = Path("docs/least_stop.png")


@click.command()
@click.option("--start", "starts", multiple=True, type=click.Choice(STARTS), default=STARTS[:2])
@click.option("--motion", "motions", multiple=True, type=click.Choice(list(MOTIONS)))
@click.option("--solve/--no-solve", default=True, help="Or only write what is solved.")
@click.option("--write", metavar="DATE", help="Write table and figure, computed on this date.")
def main(starts: tuple[str, ...], motions: tuple[str, ...], solve: bool, write: str | None) -> None:
    """The least that physics allows after a torn cable; out/least_stop keeps every solution."""
    OUT.mkdir(parents=True, exist_ok=True)
    config, _ = load("config/direct.yaml")
    if solve:
        solver = Solver(config, OUT)
        for start in starts:
            for tear in solver.missing(start, motions or tuple(MOTIONS)):
                click.echo(solver.keep(tear, start))
                sys.stdout.flush()
    if write is not None:
        limit = config.control.envelope.speed_limit
        made = table.table(OUT, config.robot.geometry, limit, write)
        table.write(made, TABLE)
        figure.draw(load_least_stops(), FIGURE)
        missing = [tear.name for tear in table.missing(OUT)]
        click.echo(f"{TABLE}: {len(missing)} stops not solved {' '.join(missing)}")
        click.echo(f"the starts differ by {max(table.spread(OUT), default=0.0):.2%} at most")


if __name__ == "__main__":
    main()
