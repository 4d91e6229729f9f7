"""`tonus campaign FILE`: every run of a study, a row of figures for each."""

from __future__ import annotations

import re
from pathlib import Path

import click
from rich.console import Console

from tonus.config.loader import load_parameter_study
from tonus.config.schema.parameter_study import ParameterStudy
from tonus.tools.cli.campaign.progress import Progress
from tonus.tools.errors import ToolError
from tonus.tools.folders import make_folder
from tonus.tools.study.engine import DASK, LOCAL, Share, carry_out
from tonus.tools.study.groups import differences, groups, number, told
from tonus.tools.study.names import need_known
from tonus.tools.study.page import write_page
from tonus.tools.study.play import COMPLETED, Row
from tonus.tools.study.store import seconds, write_table
from tonus.tools.study.trials import trials

_SHARE = re.compile(r"(\d+)/(\d+)")
_SHOWN = 20
"""combinations in the printed table"""


def _share(ctx: click.Context, param: click.Parameter, value: str | None) -> Share | None:
    if value is None:
        return None
    found = _SHARE.fullmatch(value)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise click.BadParameter("write I/N, as 1/4 to 4/4", ctx, param)
    return Share(int(found[1]), int(found[2]))


@click.command()
@click.argument("study")
@click.option("--workers", type=click.IntRange(1, 256), default=2, show_default=True)
@click.option(
    "--shard",
    metavar="I/N",
    callback=_share,
    help="Play only this share; put them together with merge.",
)
@click.option(
    "--engine", default=LOCAL, show_default=True, metavar="local|dask://HOST:PORT",
    help="Where: processes of this host, or the workers of a running Dask scheduler.",
)  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path), help="Folder. Default: out/NAME.")
@click.option("--count", is_flag=True, help="Print the number of runs and the first command.")
def play(
    study: str, *, workers: int, shard: Share | None, engine: str, out: Path | None, count: bool
) -> None:
    """Play the runs of STUDY, a YAML file (docs/studies.md), in virtual time.

    Each run is a line in OUT/trials.jsonl at once; after Ctrl-C the same command goes on. Then and
    at the end OUT has trials.parquet, a row a run, and index.html. A run that fails is a row. Exit
    code 1: not every run was completed.
    """
    settings = load_parameter_study(study)
    need_known(settings)
    if engine != LOCAL and not engine.startswith(DASK):
        raise ToolError(f"--engine {engine}: choose {LOCAL} or {DASK}HOST:PORT")
    planned = trials(settings)
    if count:
        click.echo(f"{len(planned)} runs; the first: {planned[0].command(settings)}")
        return
    folder = out if out is not None else Path("out") / settings.name
    make_folder(folder)
    part = shard or Share()
    progress = Progress(Console(stderr=True, highlight=False, markup=False), "not completed")
    found = carry_out(settings, folder, workers=workers, engine=engine, part=part, tell=progress)
    files = [write_table(settings, found.rows, folder)]
    if part.of == 1:
        files.append(write_page(settings, found.rows, folder))
    _tell(settings, found.rows, files)
    if found.interrupted:
        done = f"interrupted after {len(found.rows)} of {len(found.trials)} runs"
        click.echo(f"{done}; the same command goes on")
        raise click.exceptions.Exit(1)
    if part.of > 1:
        click.echo(f"share {part.number} of {part.of}; all of them: tonus campaign merge FOLDER...")
    raise click.exceptions.Exit(0 if all(r["verdict"] == COMPLETED for r in found.rows) else 1)


def _tell(study: ParameterStudy, rows: list[Row], files: list[Path]) -> None:
    for found in (groups(study, rows), differences(study, rows)):
        for group in found[:_SHOWN]:
            named = "  ".join(f"{key} {number(value)}" for key, value in group.labels.items())
            means = ((figure, told(group, figure)) for figure in study.shown)
            shown = "  ".join(f"{figure} {mean}" for figure, mean in means if mean)
            bad = f"  {group.bad} of {len(group.rows)} not completed" if group.bad else ""
            click.echo(f"  {named or 'all'}: {shown}{bad}")
        left = len(found) - _SHOWN
        if left > 0:
            click.echo(f"  and {left} more")
    failed = [row for row in rows if row["verdict"] != COMPLETED]
    for row in failed[:3]:
        click.echo(f"  {row['verdict']}: {row['reason']}\n    {row['command']}")
    click.echo(
        f"{len(rows)} runs, {len(failed)} not completed, {seconds(rows):.0f} s of one processor; "
        + ", ".join(map(str, files))
    )
