"""`tonus log timing`: a run's timing held against budgets."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tonus.config.loader import load_budget
from tonus.runtime.states import State
from tonus.tools.cli.damage import tell_damage
from tonus.tools.log import Log
from tonus.tools.log import open as open_log
from tonus.tools.log.timing import Judgement, histogram, judge

_EDGES = np.array([0.0, 25, 50, 100, 150, 200, 300, 400, 500, 700, 1000, 2000, 5000, 1e4])
"""us, of the histograms' bins"""
_WIDTH = 40
_MARKS = {True: "[green]ok[/]", False: "[red]over[/]", None: "[dim]no figure[/]"}


@click.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--budget",
    default="lab",
    show_default=True,
    help="A file of budgets, or the name of one in config/budgets.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON list instead of tables.")
def timing(files: tuple[Path, ...], budget: str, *, as_json: bool) -> None:
    """Judge the timing of FILES: each line of the budget passes or fails. Exit code 1 when any
    fails."""
    asked = load_budget(budget)
    console = Console(highlight=False)
    found: list[dict[str, Any]] = []
    logs: list[Log] = []
    passed = True
    for file in files:
        log = open_log(file)
        logs.append(log)
        judgement = judge(log, asked)
        passed &= judgement.passed
        found.append({"file": str(file), "budget": asked.name, **_plain(judgement)})
        if not as_json:
            _show(console, log, asked.name, judgement)
    if as_json:
        click.echo(json.dumps(found, indent=2))
    tell_damage(logs)
    raise click.exceptions.Exit(0 if passed else 1)


def _plain(judgement: Judgement) -> dict[str, Any]:
    return {
        "ticks": judgement.ticks,
        "virtual": judgement.virtual,
        "passed": judgement.passed,
        "lines": [
            {
                "signal": line.limit.signal,
                "at": line.statistic,
                "value": line.value,
                "at_most": line.limit.at_most,
                "passed": line.passed,
            }
            for line in judgement.lines
        ],
    }


def _show(console: Console, log: Log, budget: str, judgement: Judgement) -> None:
    table = Table("signal", "at", title=escape(f"{log.path}, budget {budget}"))
    table.title_justify = "left"
    for name in ("value", "at most"):
        table.add_column(name, justify="right")
    table.add_column("")
    for line in judgement.lines:
        value = "" if line.value is None else f"{line.value:.4g}"
        limit = line.limit
        table.add_row(
            limit.signal, line.statistic, value, f"{limit.at_most:g}", _MARKS[line.passed]
        )
    console.print(table)
    if judgement.virtual:
        console.print("virtual time: this log has no figures of a host")
    else:
        _draw(console, log)
    failed = sum(line.passed is False for line in judgement.lines)
    verdict = f"{failed} of {len(judgement.lines)} over budget" if failed else "within budget"
    console.print(f"{verdict}, {judgement.ticks} ticks judged")


def _draw(console: Console, log: Log) -> None:
    """Histograms over HOLD and ACTIVE: a thousand ticks make a bar where one makes a dot."""
    rows = log["/tonus/timing"]
    rows = rows[np.isin(log["/tonus/state"]["state"], [State.HOLD, State.ACTIVE])]
    shown = {
        "wake-up": rows["wakeup_us"],
        "cycle": rows["collect_us"] + rows["compute_us"] + rows["publish_us"],
    }
    for name, values in shown.items():
        counts = histogram(values.astype(np.float64), _EDGES)
        most = np.log10(max(counts.max(), 1) + 1.0)
        console.print(f"{name}, us (logarithmic)")
        for low, high, count in zip(_EDGES[:-1], _EDGES[1:], counts.tolist(), strict=True):
            if count:
                bar = "▇" * max(1, round(_WIDTH * np.log10(count + 1.0) / most))
                console.print(f"  {low:5.0f} to {high:5.0f}  {bar} {count}")
