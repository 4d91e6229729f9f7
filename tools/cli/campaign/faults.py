"""`tonus campaign faults`: faults at random, each episode judged against the truth."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any, get_args

import click
from rich.console import Console

from tonus.config.loader import load_study
from tonus.config.schema.campaign import BusName, Study
from tonus.tools.campaign import regression
from tonus.tools.campaign.campaign import Campaign, carry_out
from tonus.tools.campaign.episode import Episode
from tonus.tools.campaign.judge import Row
from tonus.tools.campaign.minimise import minimise
from tonus.tools.campaign.table import lines, table
from tonus.tools.cli.campaign.progress import Progress
from tonus.tools.errors import ToolError

_SHOWN = 5
"""violations shown in words"""
BUSES: tuple[BusName, ...] = get_args(BusName)


@click.command()
@click.argument("study", default="faults")
@click.option("--episodes", type=click.IntRange(min=1), default=300, show_default=True)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True)
@click.option("--bus", type=click.Choice([*BUSES, "all"]), default="all", show_default=True)
@click.option("--workers", type=click.IntRange(1, 256), default=2, show_default=True)
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("out/campaign"), show_default=True
)
@click.option("--resume", is_flag=True, help="Go on with what --out holds of this campaign.")
@click.option("--only", type=click.IntRange(min=0), help="Play one episode, in --out/episode_N.")
@click.option(
    "--minimise", "reduce", type=click.IntRange(min=0), default=3, show_default=True,
    help="Number of kinds of violation to reduce to scenarios in --out/violations.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print the counts as JSON and nothing else.")
def faults(
    study: str,
    *,
    episodes: int,
    seed: int,
    bus: str,
    workers: int,
    out: Path,
    resume: bool,
    only: int | None,
    reduce: int,
    as_json: bool,
) -> None:
    """Play the episodes of STUDY: one to three faults each, in every state, in virtual time, and
    check each against config/bounds.yaml.

    Every episode is a line in OUT/episodes.jsonl; after Ctrl-C --resume goes on. Exit code 1: a
    bound was broken, or not every episode was played.
    """
    settings = load_study(study)
    buses = tuple(each for each in BUSES if each in settings.configs and bus in (each, "all"))
    if not buses:
        raise ToolError(f"study {settings.name}: names no configuration for the bus {bus}")
    if only is not None:
        out = out / f"episode_{only}"
    console = Console(quiet=as_json, highlight=False, soft_wrap=True, markup=False)
    found = carry_out(
        settings,
        seed,
        buses,
        episodes,
        out,
        workers=workers,
        resume=resume,
        only=only,
        tell=Progress(console, "broke a bound"),
    )
    broken = [row for row in found.rows if row["violations"]]
    again = f"tonus campaign faults {shlex.quote(study)} --seed {seed} --bus {bus} --only"
    for row in broken[:_SHOWN] if only is None else found.rows:
        _show(console, row, again)
    files = _reduced(settings, found, workers, out, reduce)
    counted = table(settings, buses, found.rows)
    console.print("\n".join(lines(counted)))
    for file in files:
        console.print(f"  reduced to {file}")
    console.print(f"{len(found.rows)} episodes in {found.seconds:.0f} s; {out / 'episodes.jsonl'}")
    if found.interrupted:
        console.print("interrupted: the same command with --resume goes on from here")
    if as_json:
        click.echo(json.dumps(counted.as_json() | {"seconds": round(found.seconds, 1)}, indent=2))
    raise click.exceptions.Exit(1 if broken or found.interrupted else 0)


def _show(console: Console, row: Row, again: str) -> None:
    episode = row["episode"]
    told = ", ".join(f"{each['kind']} in {each['state']}" for each in row["strikes"])
    setup: dict[str, Any] = episode["setup"]
    controller = setup["overrides"]["control.controller"]
    console.print(f"{again} {row['index']}")
    console.print(
        f"    {setup['config']} {controller}: {told or 'no fault struck'}; {row['reason']}"
    )
    for violation in row["violations"]:
        console.print(
            f"    {violation['invariant']} at {violation['at']:.3f} s: {violation['text']}"
        )


def _reduced(study: Study, found: Campaign, workers: int, out: Path, count: int) -> list[Path]:
    """One violation of each sort, as far as ``count`` reaches, in its simplest form."""
    by_index = {episode.index: episode for episode in found.episodes}
    sorts: dict[tuple[str, ...], tuple[Episode, str]] = {}
    rows = sorted(found.rows, key=lambda row: len(row["strikes"]))
    for row in rows:
        for violation in row["violations"]:
            kinds = sorted({strike["kind"] for strike in row["strikes"]})
            sort = (violation["invariant"], *kinds)
            sorts.setdefault(sort, (by_index[row["index"]], violation["invariant"]))
    files = []
    for sort, (episode, invariant) in list(sorts.items())[:count]:
        simple = minimise(study, episode, invariant, workers)
        name = "_".join([*sort, str(episode.index)])
        files.append(regression.write(out / "violations", name, simple, invariant))
    return files
