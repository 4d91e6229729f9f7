"""`tonus check`: everything that can be known about a configuration before a run."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict

import click

from tonus.config import load
from tonus.config.errors import ConfigError
from tonus.config.loader import load_catalogue
from tonus.tools.check import rules as rules
from tonus.tools.check.finding import Finding
from tonus.tools.cli.failures import line
from tonus.tools.settings import overrides_of


@click.command()
@click.argument("config")
@click.option("--scenario", metavar="NAME", help="Instead of the one that CONFIG names.")
@click.option(
    "--controller", help="By name, or as package.module:Class, instead of the configuration's."
)
@click.option(
    "--set", "settings", multiple=True, metavar="KEY=VALUE", help="One value of the configuration."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON list instead of a table.")
def check(
    config: str,
    scenario: str | None,
    controller: str | None,
    *,
    settings: tuple[str, ...],
    as_json: bool,
) -> None:
    """Validate CONFIG: schema, bus load, identifiers, workspace, limits. Nothing is started.

    What does not fit the schema is said in a line each, on standard error; exit code 2.
    """
    overrides = overrides_of(settings)
    if controller is not None:
        overrides["control.controller"] = controller
    try:
        loaded, played = load(config, scenario, overrides)
    except ConfigError as error:
        for other in error.others:
            click.echo(line(str(other)), err=True)
        raise
    findings = rules.check(loaded, played, timed=True)
    if loaded.operation.scenarios is not None:
        findings += rules.check_catalogue(loaded, played, load_catalogue(config))
    failed = [finding for finding in findings if not finding.ok]
    if as_json:
        click.echo(json.dumps([asdict(finding) for finding in findings], indent=2))
    else:
        for finding in findings:
            click.echo(_line(finding))
        verdict = f"{len(failed)} of {len(findings)} checks failed" if failed else (
            f"all {len(findings)} checks passed"
        )  # fmt: skip
        click.echo(f"{config}, scenario {played.name}: {verdict}")
    if failed:
        sys.exit(1)


def _line(finding: Finding) -> str:
    text = f"{'ok' if finding.ok else 'FAILED':<7} {finding.rule:<13} {finding.text}"
    if not finding.ok:
        text += f"; {finding.where}: {finding.remedy}"
    return text
