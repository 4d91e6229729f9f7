"""`tonus log compare`: runs side by side."""

from __future__ import annotations

import json
from pathlib import Path

import click
from rich.console import Console
from rich.markup import escape

from tonus.tools.cli.damage import tell_damage
from tonus.tools.draft import write_whole
from tonus.tools.errors import ToolError
from tonus.tools.log import open as open_log
from tonus.tools.log.attached import played
from tonus.tools.paper.table import Spread, Table
from tonus.tools.report.compare import Judged, load_of
from tonus.tools.report.compare import compare as put_side_by_side
from tonus.tools.report.differences import differences, shown


@click.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write the table to a file too: .csv or .html.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")
def compare(files: tuple[Path, ...], out: Path | None, *, as_json: bool) -> None:
    """Compare runs by the indicators of the paper's Table 3. FILES of one controller are its
    repetitions; controllers are compared over the scenarios that all of them have played."""
    logs = [open_log(file) for file in files]
    table, judged = put_side_by_side(logs)
    unlike = differences(logs)
    if out is not None:
        _write(table, out)
    if as_json:
        click.echo(json.dumps(_plain(table, judged) | {"differences": unlike}, indent=2))
    else:
        _show(table, judged)
        for line in shown(unlike):
            click.echo(f"differs: {line}")
        if out is not None:
            click.echo(out)
    tell_damage(each.log for each in judged)


def _show(table: Table, judged: list[Judged]) -> None:
    console = Console(highlight=False)
    for each in judged:
        row = each.row
        ended = f"ended in {row.fault}" if row.fault else row.reason
        load = load_of(played(each.log))
        kind = f"{row.kind}, {load}" if load else row.kind
        text = f"{each.log.path}: {row.controller}, {row.case} ({kind}), {ended}"
        console.print(escape(text), soft_wrap=True)
    console.print(table)


def _write(table: Table, out: Path) -> None:
    made = {".csv": table.csv, ".html": table.html}.get(out.suffix)
    if made is None:
        raise ToolError(f"{out}: a table is written as .csv or .html; correct the name")
    try:
        write_whole(out, made())
    except OSError as error:
        raise ToolError(f"{out}: {error.strerror}; choose another with --out") from error


def _plain(table: Table, judged: list[Judged]) -> dict[str, object]:
    names = [column.name for column in table.columns[2:]]
    rows = []
    for indicator, unit, *cells in table.rows:
        spreads = {
            name: cell.as_json()
            for name, cell in zip(names, cells, strict=True)
            if isinstance(cell, Spread)
        }
        rows.append({"indicator": indicator, "unit": unit, "controllers": spreads})
    logs = [
        {
            "file": each.row.key,
            "controller": each.row.controller,
            "scenario": each.row.case,
            "kind": each.row.kind,
            "against": each.against,
            "fault": each.row.fault,
            "indicators": each.row.indicators,
        }
        for each in judged
    ]
    return {"rows": rows, "logs": logs, "notes": table.notes}
