"""`tonus doctor`: what this host grants and refuses a real-time loop, measured."""

from __future__ import annotations

import json
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table
from rich.text import Text

from tonus.config import load
from tonus.tools.cli.numbers import FiniteRange
from tonus.tools.doctor import doctor as rules
from tonus.tools.doctor import lab
from tonus.tools.doctor.finding import Finding, Verdict, worst

_STYLES = {Verdict.GOOD: "green", Verdict.BETTER: "yellow", Verdict.BAD: "bold red"}


@click.command()
@click.argument("config", default="config/can.yaml")
@click.option("--seconds", type=FiniteRange(0.1, 3600.0), default=5.0, show_default=True)
@click.option("--out", type=click.Path(path_type=Path), default=Path("out"), show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object instead of a table.")
def doctor(config: str, seconds: float, out: Path, *, as_json: bool) -> None:
    """Measure this host for the daemon of CONFIG; nothing on it is changed.

    Exits with 1 when something is bad. The report goes into the logs of the next day's runs.
    """
    settings, _ = load(config)
    console = Console(highlight=False, soft_wrap=True)
    say = (lambda _: None) if as_json else (lambda text: console.print(f"  {text} ..."))
    findings = [*rules.examine(settings, out, seconds, say), *lab.examine(settings, say)]
    found = rules.report(settings, findings, seconds)
    rules.keep(found)
    if as_json:
        click.echo(json.dumps(found, indent=2))
    else:
        _show(console, findings, found["period_us"])
    raise click.exceptions.Exit(1 if worst(findings) is Verdict.BAD else 0)


def _show(console: Console, findings: list[Finding], period_us: int) -> None:
    table = Table("what", "measured", "verdict", box=None, pad_edge=False)
    for finding in findings:
        style = _STYLES[finding.verdict]
        table.add_row(finding.name, finding.measured, Text(finding.verdict, style=style))
    console.print(table)
    remedies = [finding for finding in findings if finding.remedy]
    if remedies:
        console.print("\nto change it:")
    for finding in remedies:
        console.print(f"  {finding.name}:", markup=False)
        console.print(f"    {finding.remedy}", markup=False)
    console.print(
        f"\nthis host, for a period of {period_us / 1000:g} ms: {worst(findings)}", markup=False
    )
