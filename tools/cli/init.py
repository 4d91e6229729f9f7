"""`tonus init`: a complete configuration to start from."""

from __future__ import annotations

from pathlib import Path

import click

from tonus.tools.start_configuration import write_configuration


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option(
    "--like",
    default="config/can.yaml",
    show_default=True,
    help="The shipped configuration to start from.",
)
def init(folder: Path, like: str) -> None:
    """Write a complete, commented configuration to DIR, which is new or empty.

    Robot, buses, drives, control, lab and one scenario; it runs as it is.
    """
    files = write_configuration(folder, like)
    for file in files:
        click.echo(f"  {file}")
    click.echo(f"next: tonus check {files[0]}")
