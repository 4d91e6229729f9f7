"""`tonus log figure`: one picture of a run, or of several."""

from __future__ import annotations

from pathlib import Path

import click

from tonus.tools.cli.damage import tell_damage
from tonus.tools.errors import ToolError
from tonus.tools.log import open as open_log
from tonus.tools.report.plots import PLOTS, draw, kind_of, write


@click.command()
@click.argument("files", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "--what", type=click.Choice(list(PLOTS)), default="overview", show_default=True, metavar="NAME"
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    help="A .png, .svg or .pdf. Default: FILE.NAME.png beside FILE.",
)
@click.option("--list", "listed", is_flag=True, help="Print the names and what each shows.")
def figure(files: tuple[Path, ...], what: str, out: Path | None, *, listed: bool) -> None:
    """Draw one figure of a run. Several FILES are runs in one picture, aligned at START. Exit code
    1 for a damaged log, drawn up to the damage."""
    if listed:
        for name, plot in PLOTS.items():
            runs = "" if plot.several else "; of one run"
            click.echo(f"  {name:<10} {plot.line}{runs}")
        return
    if not files:
        raise ToolError("no log is named; name a log that `tonus run` wrote")
    path = files[0].with_name(f"{files[0].stem}.{what}.png") if out is None else out
    kind_of(path)
    logs = [open_log(file) for file in files]
    write(draw(logs, what), path)
    click.echo(path)
    tell_damage(logs)
