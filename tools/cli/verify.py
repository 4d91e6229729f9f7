"""`tonus verify`: scenarios with expectations, as a table of passed and failed."""

from __future__ import annotations

import re
from pathlib import Path

import click

from tonus.config import ConfigError, load
from tonus.tools.check.rules import check
from tonus.tools.cli.failures import line
from tonus.tools.errors import ToolError
from tonus.tools.folders import make_folder
from tonus.tools.settings import overrides_of
from tonus.tools.verify import junit
from tonus.tools.verify.names import need_names
from tonus.tools.verify.play import Case, Judged, play_all


@click.command()
@click.argument("scenarios", nargs=-1, required=True)
@click.option("--config", default="config/can.yaml", show_default=True, help="With a lab.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the lab's noise.")
@click.option(
    "--set", "settings", multiple=True, metavar="KEY=VALUE", help="One value of the configuration."
)
@click.option("--jobs", type=click.IntRange(1, 64), default=1, show_default=True, help="Processes.")
@click.option("--junit", "report", type=click.Path(path_type=Path), help="File for a CI server.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/verify"),
    show_default=True,
    help="Folder for logs and summaries, one below it for each scenario.",
)
def verify(
    scenarios: tuple[str, ...],
    config: str,
    seed: int | None,
    *,
    settings: tuple[str, ...],
    jobs: int,
    report: Path | None,
    out: Path,
) -> None:
    """Play each of SCENARIOS in virtual time and judge its run by what it expects.

    A scenario is the name of a shipped one or a YAML file. A warning or error that no expectation
    names fails as well. Exit code 1: an expectation was not met; 2: a scenario cannot be played,
    which keeps none of the others from being judged.
    """
    cases, judged, told = [], [], set[str]()
    for name in scenarios:
        try:
            cases.append(_case(name, config, seed, settings, out, scenarios))
        except (ConfigError, ToolError) as error:
            judged.append(Judged(name, 0.0, [], str(error)))
            _refuse(judged[-1], told)
    for each in play_all(cases, jobs) if cases else ():
        judged.append(each)
        if each.refused:
            _refuse(each, told)
        else:
            _show(each)
    if report is not None:
        make_folder(report.parent)
        junit.write(report, judged)
    refused = sum(bool(each.refused) for each in judged)
    failed = sum(each.failed for each in judged)
    if refused < len(judged):
        played = len(judged) - refused
        verdict = f"{failed} of {played} failed" if failed else f"all {played} passed"
        more = f", {refused} refused" if refused else ""
        click.echo(f"{config}: {verdict}{more}; logs in {out}")
    raise click.exceptions.Exit(2 if refused else 1 if failed else 0)


def _refuse(judged: Judged, told: set[str]) -> None:
    """Say why, once: a mistake in the configuration is one of every scenario."""
    if judged.refused not in told:
        told.add(judged.refused)
        click.echo(line(judged.refused), err=True)


def _case(
    name: str,
    config: str,
    seed: int | None,
    settings: tuple[str, ...],
    out: Path,
    every: tuple[str, ...],
) -> Case:
    """Raises `ConfigError` and `ToolError` for what cannot be played."""
    loaded, scenario = load(config, name, overrides_of(settings))
    if loaded.lab is None:
        raise ToolError(f"{config}: lab: is missing; verify plays in the lab alone")
    if not scenario.expect:
        raise ToolError(f"{name}: expect: is missing; state what the run has to do")
    try:
        need_names(loaded, scenario.expect)
    except ToolError as error:
        raise ToolError(f"{name}: {error}") from None
    for finding in check(loaded, scenario):
        if not finding.ok:
            raise ToolError(f"{name}: {finding.where}: {finding.text}; {finding.remedy}")
    chosen = loaded.lab.seed if seed is None else seed
    number = f"{every.index(name) + 1}-" if len(every) > 1 else ""
    folder = number + re.sub(r"[^\w.-]+", "-", scenario.name)
    return Case(name, loaded, scenario, chosen, out / folder)


def _show(judged: Judged) -> None:
    click.echo(f"{'FAILED' if judged.failed else 'passed':<7} {judged.name}")
    for each in judged.verdicts:
        mark = "FAILED" if each.problem else "ok"
        tail = f"; {each.problem}" if each.problem else ""
        click.echo(f"  {mark:<7} {each.expected}{tail}")
