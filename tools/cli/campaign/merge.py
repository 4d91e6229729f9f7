"""`tonus campaign merge`: one table of the shares of a study."""

from __future__ import annotations

from pathlib import Path

import click

from tonus.tools.folders import make_folder
from tonus.tools.study.page import write_page
from tonus.tools.study.store import merged, write_table


@click.command()
@click.argument("folders", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder.")
def merge(folders: tuple[Path, ...], *, out: Path) -> None:
    """Put the shares in FOLDERS together: the table and page that one run of the study would have
    written, byte by byte."""
    study, rows = merged(folders)
    make_folder(out)
    table = write_table(study, rows, out)
    page = write_page(study, rows, out)
    click.echo(f"{len(rows)} runs; {table}, {page}")
