"""`tonus log export`: a log in the formats of others."""

from __future__ import annotations

from pathlib import Path

import click

from tools.log import open as open_log
from tools.log.export import FORMATS
from tools.log.export import export as carry_out


@click.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--format", "kind", type=click.Choice(FORMATS), required=True)
@click.option("--topics", help="Names with commas between; all, if not given.")
@click.option("--from", "start", type=float, help="s since the log's beginning.")
@click.option("--to", "end", type=float, help="s since the log's beginning.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder. Default: FILE.export.")
def export(
    files: tuple[Path, ...],
    kind: str,
    topics: str | None,
    start: float | None,
    end: float | None,
    out: Path | None,
) -> None:
    """Write FILES, the segments of one run, as a table for each topic, or all bus frames as one
    .asc or .blf."""
    log = open_log(files)
    if start is not None or end is not None:
        log = log.between(0.0 if start is None else start, float("inf") if end is None else end)
    out = files[0].with_name(f"{files[0].stem}.export") if out is None else out
    names = [name.strip() for name in topics.split(",")] if topics else []
    written = carry_out(log, out, kind, names)
    for topic, path in written.items():
        click.echo(f"  {topic:<24} {path or '- no table can be made of it'}")
    if log.damage:
        click.echo(f"damaged: {log.damage}; exported up to there", err=True)
