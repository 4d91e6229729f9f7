"""`tonus log export`: a log in the formats of others."""

from __future__ import annotations

import math
from pathlib import Path

import click

from tonus.tools.cli.damage import tell_damage
from tonus.tools.errors import ToolError
from tonus.tools.log import open as open_log
from tonus.tools.log.export import FORMATS, export_merged
from tonus.tools.log.export import export as carry_out


@click.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--format", "kind", type=click.Choice(FORMATS), required=True)
@click.option("--topics", help="Topics, separated by commas. Default: all.")
@click.option(
    "--merge",
    is_flag=True,
    help="One table with a row a tick: of each topic its latest message.",
)
@click.option("--from", "start", type=float, help="s since the log's beginning.")
@click.option("--to", "end", type=float, help="s since the log's beginning.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder. Default: FILE.export.")
def export(
    files: tuple[Path, ...],
    kind: str,
    topics: str | None,
    *,
    merge: bool,
    start: float | None,
    end: float | None,
    out: Path | None,
) -> None:
    """Write FILES, the segments of one run, as a table for each topic (csv, parquet), as one file
    for MATLAB with a struct for each (mat), or all bus frames as one .asc or .blf. Names of states,
    faults and commands stand beside their numbers. Exit code 1 where a damaged file was exported in
    part."""
    _window(start, end)
    log = open_log(files)
    if start is not None or end is not None:
        log = log.between(0.0 if start is None else start, float("inf") if end is None else end)
        span = log.span_ns
        if span is None or span[0] > span[1]:
            raise ToolError(f"{files[0]}: holds no message there; choose another --from or --to")
    out = files[0].with_name(f"{files[0].stem}.export") if out is None else out
    names = [name.strip() for name in topics.split(",")] if topics else []
    if merge:
        merged = export_merged(log, out, kind, names)
        click.echo(f"  {merged.rows} rows  {merged.path}")
        if merged.left_out:
            click.echo(f"  {merged.left_out} ticks before the first message of a topic left out")
    else:
        for topic, path in carry_out(log, out, kind, names).items():
            click.echo(f"  {topic:<24} {path or '- cannot be written as a table'}")
    tell_damage([log])


def _window(start: float | None, end: float | None) -> None:
    """Raises `ToolError` for a stretch of time in which nothing can be."""
    for name, value in (("--from", start), ("--to", end)):
        if value is not None and not math.isfinite(value):
            raise ToolError(
                f"{name} {value}: is not a time; give seconds since the log's beginning"
            )
    if start is not None and end is not None and start >= end:
        raise ToolError(f"--from {start:g} --to {end:g}: ends before it begins; exchange them")
