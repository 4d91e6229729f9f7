"""`tonus new`: a project with HIL tests to start from."""

from __future__ import annotations

from pathlib import Path

import click

from tonus.tools.project.write import write_project


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option(
    "--like",
    default="config/can.yaml",
    show_default=True,
    help="The shipped configuration that the robot is a copy of.",
)
def new(folder: Path, like: str) -> None:
    """Write a project to DIR, which is new or empty: a robot, a scenario, a controller, two HIL
    tests, a CI file and a README. Its tests pass as they are."""
    for file in write_project(folder, like):
        click.echo(f"  {file}")
    click.echo(f"next: cd {folder} && pytest")
