"""`tonus log layout`: plots arranged for a viewer."""

from __future__ import annotations

from pathlib import Path

import click

from tonus.config import load
from tonus.tools.draft import write_whole
from tonus.tools.errors import ToolError
from tonus.tools.log.layout import VIEWERS


@click.command()
@click.argument("viewer", type=click.Choice(list(VIEWERS)))
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    help="The file; by default the usual name in this folder. - prints it.",
)
@click.option(
    "--config", default="can.yaml", show_default=True, help="Of the robot whose logs are shown."
)
def layout(viewer: str, out: Path | None, config: str) -> None:
    """Write a layout that shows a run's log in VIEWER at once: motion, cables, safety, timing.

    Foxglove and Lichtblick: "Import from file" in the layouts menu. PlotJuggler: "Load Layout",
    after the log.
    """
    name, make = VIEWERS[viewer]
    text = make(load(config)[0].robot.cables)
    if out is not None and str(out) == "-":
        click.echo(text, nl=False)
        return
    file = Path(name) if out is None else out
    try:
        write_whole(file, text)
    except OSError as error:
        raise ToolError(f"{file}: {error.strerror}; choose another with --out") from error
    click.echo(str(file))
