"""`tonus log identify`: the robot's parameters from its own records."""

from __future__ import annotations

import json
from pathlib import Path

import click
from rich.console import Console

from tonus.tools.cli.numbers import FiniteRange
from tonus.tools.errors import ToolError
from tonus.tools.identify import identify as find
from tonus.tools.identify.figure import draw
from tonus.tools.identify.shown import show
from tonus.tools.identify.written import to_json, to_yaml

_M = 1e-3


@click.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), default=Path("out"), show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print identify.json and nothing else.")
@click.option("--truth", is_flag=True, help="Add a lab's true values and the errors.")
@click.option(
    "--anchor-sigma",
    metavar="MM",
    type=FiniteRange(min=0.0),
    default=1.0,
    show_default=True,
    help="Standard error of the configured anchors; included in the intervals.",
)
def identify(
    files: tuple[Path, ...], out: Path, *, as_json: bool, truth: bool, anchor_sigma: float
) -> None:
    """Identify masses, cables, drums and the closed loop from FILES of one robot."""
    found = find(files, truth=truth, anchor_sigma=anchor_sigma * _M)
    text = json.dumps(to_json(found), indent=2)
    picture, data, fragment = (out / f"identify.{kind}" for kind in ("png", "json", "yaml"))
    try:
        out.mkdir(parents=True, exist_ok=True)
        data.write_text(text + "\n", encoding="utf-8")
        fragment.write_text(to_yaml(found), encoding="utf-8")
        draw(found, picture)
    except OSError as error:
        reason = (error.strerror or "cannot be written").lower()
        raise ToolError(f"{out}: {reason}; choose another with --out") from error
    if as_json:
        click.echo(text)
        return
    show(Console(highlight=False), found, truth=truth)
    click.echo(f"files  {picture}  {data}  {fragment}")
