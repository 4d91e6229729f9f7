"""`tonus paper`: the paper's test protocol, played, measured and held against what it says."""

from __future__ import annotations

import json
from importlib.metadata import version
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn

from tonus.config import Config, load
from tonus.config.loader import load_protocol
from tonus.config.schema.protocol import Protocol, Selection
from tonus.tools.errors import ToolError
from tonus.tools.paper.campaign import Campaign, Job, carry_out, prepare
from tonus.tools.paper.campaign import Progress as Standing
from tonus.tools.paper.plants import refuse
from tonus.tools.paper.protocol import LITERAL, robot_seconds, runs
from tonus.tools.paper.publish import publish
from tonus.tools.tune.tuned import not_tuned

_STAGES = (1, 2, 3)
_PLAIN_STEPS = 20
"""lines of progress where there is no terminal"""


@click.command()
@click.argument("config", default="config/direct.yaml")
@click.option("--reps", type=click.IntRange(1, 99), help="Seeds in the lab.  [default: 5]")
@click.option("--quick", is_flag=True, help="A few tests, controllers and seeds: minutes.")
@click.option("--stages", default="1,2,3", show_default=True, help="Of the paper's three.")
@click.option("--controllers", help="By name, with commas between.  [default: all]")
@click.option("--plants", type=click.IntRange(0, 999), help="Drawn at random.  [default: 200]")
@click.option("--jobs", type=click.IntRange(1, 64), default=2, show_default=True, help="At a time.")
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("out/paper"), show_default=True
)
@click.option(
    "--tuned",
    type=click.Path(path_type=Path),
    help="What tonus tune wrote for CONFIG's robot; without it config/tuned.yaml.",
)
@click.option("--json", "as_json", is_flag=True, help="Print paper.json and nothing else.")
def paper(
    config: str,
    *,
    reps: int | None,
    quick: bool,
    stages: str,
    controllers: str | None,
    plants: int | None,
    jobs: int,
    out: Path,
    tuned: Path | None,
    as_json: bool,
) -> None:
    """Play the paper's three stages on CONFIG's robot in the lab, in virtual time, and write
    tables, figures and a verdict on each of its claims to --out.

    A trial that is done is kept: after Ctrl-C the same command goes on where it stopped. Exit code
    1: some trials could not be run, or not all were.
    """
    settings, _ = load(config)
    refuse(settings, config)
    protocol = load_protocol()
    selection = _selected(protocol, quick, reps, controllers, plants)
    untuned = not_tuned(settings, selection.controllers, tuned)
    todo = prepare(protocol, settings, runs(protocol, settings, selection, _stages(stages)))
    console = Console(quiet=as_json, highlight=False, soft_wrap=True)
    seconds = sum(robot_seconds(settings, job.run) for job in todo)
    console.print(
        f"{len(todo)} trials, {_span(seconds)} of robot time, {jobs} at a time; "
        f"each is kept in {out / 'trials'}"
    )
    campaign = _watched(console, todo, out, jobs)
    _note(out, settings, selection, campaign, len(todo))
    if campaign.interrupted:
        console.print(
            f"interrupted: {len(campaign.results.rows)} of {len(todo)} trials are done; "
            "the same command goes on from here"
        )
        raise click.exceptions.Exit(1)
    factor = campaign.robot_seconds / campaign.wall_seconds if campaign.wall_seconds else 0.0
    if campaign.robot_seconds:
        console.print(
            f"{_span(campaign.robot_seconds)} of robot time in {_span(campaign.wall_seconds)}: "
            f"{factor:.1f} x real time on {jobs} processes"
        )
    campaign.results.untuned = untuned
    summary = publish(campaign.results, out, console.print)
    for row in campaign.failed:
        console.print(f"could not be run: {row.key}: {row.reason}", markup=False)
    if as_json:
        click.echo(json.dumps(summary, indent=2))
    raise click.exceptions.Exit(1 if campaign.failed else 0)


def _selected(
    protocol: Protocol, quick: bool, reps: int | None, controllers: str | None, plants: int | None
) -> Selection:
    """The protocol's selection, as far as the options leave it."""
    selection = protocol.quick if quick else protocol.full
    changes: dict[str, Any] = {}
    if reps is not None:
        changes["repetitions"] = reps
    if plants is not None:
        changes["drawn"] = plants
    if controllers is not None:
        names = tuple(dict.fromkeys(name.strip() for name in controllers.split(",")))
        known = protocol.full.controllers
        for name in names:
            if name not in known:
                own = f"; {LITERAL} has a test of its own" if name == LITERAL else ""
                raise ToolError(
                    f"--controllers: there is no {name or 'nameless controller'} in the protocol; "
                    f"choose of {', '.join(known)}{own}"
                )
        changes["controllers"] = names
    return selection.model_copy(update=changes)


def _stages(text: str) -> frozenset[int]:
    names = [part.strip() for part in text.split(",")]
    if not all(name in {str(stage) for stage in _STAGES} for name in names):
        raise ToolError(f"--stages: {text!r} is none of the paper's; give some of 1,2,3")
    return frozenset(int(name) for name in names)


def _watched(console: Console, todo: list[Job], out: Path, jobs: int) -> Campaign:
    """Carry the campaign out with a line that tells how far it has come."""
    if not console.is_terminal:
        told = 0

        def tell(standing: Standing) -> None:
            nonlocal told
            step = int(standing.share * _PLAIN_STEPS)
            if step > told:
                told = step
                console.print(f"  {_line(standing)}", markup=False)

        return carry_out(todo, out, jobs, tell)
    columns = (BarColumn(bar_width=30), TextColumn("{task.description}", markup=False))
    # Without a thread that draws: processes are forked meanwhile.
    with Progress(*columns, console=console, transient=True, auto_refresh=False) as shown:
        bar: TaskID = shown.add_task("starting", total=1.0)
        return carry_out(
            todo,
            out,
            jobs,
            lambda standing: shown.update(
                bar, completed=standing.share, description=_line(standing), refresh=True
            ),
        )


def _line(standing: Standing) -> str:
    return (
        f"{standing.done}/{standing.total}  {standing.factor:.1f} x real time  "
        f"{_span(standing.left)} left  {standing.latest}"
    )


def _span(seconds: float) -> str:
    """A stretch of time as one says it."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    if seconds < 5400.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"


def _note(out: Path, config: Config, selection: Selection, campaign: Campaign, trials: int) -> None:
    """campaign.json: what was run and how fast."""
    wall = campaign.wall_seconds
    note = {
        "config": config.name,
        "version": version("tonus"),
        "selection": selection.model_dump(mode="json"),
        "trials": trials,
        "done": len(campaign.results.rows),
        "kept": campaign.kept,
        "could_not_run": {row.key: row.reason for row in campaign.failed},
        "robot_seconds": round(campaign.robot_seconds, 1),
        "wall_seconds": round(wall, 1),
        "realtime_factor": round(campaign.robot_seconds / wall, 2) if wall else None,
    }
    text = json.dumps(note, indent=2) + "\n"
    (out / "campaign.json").write_text(text, encoding="utf-8")
