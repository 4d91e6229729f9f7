"""The table of least stops and its figure; and the least stop under a load, beside a run."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import get_args

import click
import numpy as np

from tests.bench.least_stop import episode, figure, table
from tests.bench.least_stop.begin import case_of
from tests.bench.least_stop.cases import MOTIONS
from tests.bench.least_stop.hold import hold_at
from tests.bench.least_stop.kept import Kept
from tests.bench.least_stop.loaded import Reached, compared, optima
from tests.bench.least_stop.model import Constants, Model
from tests.bench.least_stop.problem import Case
from tests.bench.least_stop.push import Push
from tests.bench.least_stop.solve import LOADED_STARTS, STARTS
from tests.isolated import tear
from tests.torn import Torn
from tonus.config import load
from tonus.config.loader import load_least_stops, load_study
from tonus.config.schema.campaign import BusName
from tonus.config.schema.root import Config
from tonus.tools.campaign.draw import episodes
from tonus.tools.campaign.play import play
from tonus.tools.errors import ToolError

OUT = Path("out/least_stop")
TABLE = Path("config/least_stop.yaml")
FIGURE = Path("docs/least_stop.png")
HOME = (0.0, 0.0, 0.0)
_PUSHED_S = 1.5
"""before the break; by then it is as large as it gets"""

starts_of_load = click.option(
    "--start",
    "starts",
    multiple=True,
    type=click.Choice(LOADED_STARTS),
    default=LOADED_STARTS,
    help="Where the optimiser begins; the lowest optimum counts.",
)


@click.group()
def main() -> None:
    """The least that physics allows after a torn cable."""


@main.command("table")
@click.option("--start", "starts", multiple=True, type=click.Choice(STARTS), default=STARTS[:2])
@click.option("--motion", "motions", multiple=True, type=click.Choice(list(MOTIONS)))
@click.option("--solve/--no-solve", default=True, help="Or only write what is solved.")
@click.option("--write", metavar="DATE", help="Write table and figure, computed on this date.")
def of_table(
    starts: tuple[str, ...], motions: tuple[str, ...], solve: bool, write: str | None
) -> None:
    """Solve what is not solved yet; out/least_stop keeps every solution."""
    OUT.mkdir(parents=True, exist_ok=True)
    config, _ = load("config/direct.yaml")
    if solve:
        kept = Kept(config, OUT)
        for start in starts:
            for each in kept.missing(start, motions or tuple(MOTIONS)):
                click.echo(kept.keep(each, start))
                sys.stdout.flush()
    if write is not None:
        limit = config.control.envelope.speed_limit
        made = table.table(OUT, config.robot.geometry, limit, write)
        table.write(made, TABLE)
        figure.draw(load_least_stops(), FIGURE)
        missing = [each.name for each in table.missing(OUT)]
        click.echo(f"{TABLE}: {len(missing)} stops not solved {' '.join(missing)}")
        click.echo(f"the starts differ by {max(table.spread(OUT), default=0.0):.2%} at most")


@main.command("episode")
@click.argument("seed", type=click.IntRange(min=0))
@click.argument("bus", type=click.Choice(get_args(BusName)))
@click.argument("index", type=click.IntRange(min=0))
@click.option("--sound", is_flag=True, help="With the full force of every motor.")
@starts_of_load
def of_episode(seed: int, bus: BusName, index: int, sound: bool, starts: tuple[str, ...]) -> None:
    """Play episode INDEX of a campaign with one torn cable, and compute the least stop from it."""
    study = load_study("faults")
    drawn = episodes(study, seed, [bus], index + 1)[index]
    run = play(drawn, tail=study.times.tail, longest=study.times.longest, named=study.named)
    try:
        model = Model(episode.constants_of(run.config, drawn.setup.seed))
        case = episode.case_in(run, model, sound=sound)
        did = episode.reached(run)
    except ToolError as error:
        raise click.UsageError(f"seed {seed}, {bus} {index}: {error}") from None
    _solve(run.config, model, case, starts, did)


@main.command("pushed")
@click.argument("cable", type=click.IntRange(0, 7))
@click.option(
    "--force", type=click.FloatRange(0.0, 200.0), default=100.0, show_default=True, help="N"
)
@starts_of_load
def of_pushed(cable: int, force: float, starts: tuple[str, ...]) -> None:
    """Tear a cable at the centre under a push away from its anchor that stays, as
    `tests.bench.isolation` does, and compute the least stop."""
    config, _ = load("config/direct.yaml")
    assert config.lab is not None
    stopped = Torn(HOME).pushed(cable, force, tear)
    did = Reached(stopped.peak_speed, stopped.peak_at, stopped.peak_tension)
    anchor = np.array(config.robot.geometry.frame[cable])
    x, y, z = (float(part) for part in -force * anchor / np.linalg.norm(anchor))
    push = Push((x, y, z), begin=-_PUSHED_S)
    model = Model(Constants.of(config.robot, config.lab))
    hold = hold_at(HOME, push)
    case = case_of(model, config.robot.geometry, hold, cable, np.zeros(3), push)
    _solve(config, model, case, starts, did)


def _solve(
    config: Config, model: Model, case: Case, starts: tuple[str, ...], reached: Reached
) -> None:
    size, begin = float(np.linalg.norm(case.push.force)), 1e3 * case.push.begin
    click.echo(f"{size:.0f} N from {begin:.0f} ms after the break on, for {case.push.duration:g} s")
    found = []
    for least in optima(model, case, config.control.tension.max, starts):
        found.append(least)
        click.echo(str(least))
        sys.stdout.flush()
    click.echo(compared(found, reached))


if __name__ == "__main__":
    main()
