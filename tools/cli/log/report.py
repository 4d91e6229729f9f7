"""`tonus log report`: a log as one page to look at."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from tonus.tools.report.interactive import MISSING, available
from tonus.tools.report.page import report as write


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    help="The page. Default: report.html beside FILE.",
)
def report(file: Path, out: Path | None) -> None:
    """Write FILE as one HTML page: verdict, plots, events, settings. It opens offline; with
    tonus[view] installed its plots can be zoomed into. Exit code 1 for a damaged log."""
    page = file.with_name("report.html") if out is None else out
    if sys.stderr.isatty():
        with click.progressbar(length=1000, label=str(file), file=sys.stderr) as bar:
            verdict = write(file, page, lambda share: bar.update(round(1000 * share) - bar.pos))
    else:
        verdict = write(file, page, lambda _: None)
    click.echo(f"{verdict.headline}")
    for remark in verdict.remarks:
        click.echo(f"  {remark}")
    click.echo(f"{page}: {page.stat().st_size / 1e6:.1f} MB")
    if not available():
        click.echo(MISSING, err=True)
    if verdict.damaged:
        raise click.exceptions.Exit(1)
