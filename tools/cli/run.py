"""`tonus run`: the daemon in the foreground, with its lab where the configuration has one."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import click
import numpy as np

from tonus.config import Config, Scenario, load
from tonus.config.loader import load_catalogue
from tonus.drivers.fieldbus import Progress
from tonus.runtime.states import Fault, State
from tonus.tools import output
from tonus.tools.check.rules import check
from tonus.tools.cli.numbers import FiniteRange
from tonus.tools.draft import drafted, write_whole
from tonus.tools.errors import ToolError
from tonus.tools.log import Log
from tonus.tools.log import open as open_log
from tonus.tools.log.several import segments
from tonus.tools.run.composer import Order, Result
from tonus.tools.run.composer import run as carry_out
from tonus.tools.run.latencies import buckets
from tonus.tools.run.latencies import rows as latency_rows
from tonus.tools.run.run_folder import discard_empty, new_folder, next_folder
from tonus.tools.run.summary import Summary, missed_in, summarise, truth_at_cycles
from tonus.tools.run.viewer_process import beside
from tonus.tools.settings import overrides_of


@click.command()
@click.argument("config", type=click.Path(path_type=Path))
@click.option("--scenario", help="Name of a scenario in config/scenarios, or a YAML file.")
@click.option("--duration", type=FiniteRange(min=0.1), help="Seconds in ACTIVE.")
@click.option(
    "--controller", help="By name, or as package.module:Class, instead of the configuration's."
)
@click.option(
    "--set", "settings_", multiple=True, metavar="KEY=VALUE", help="One value of the configuration."
)
@click.option("--virtual", is_flag=True, help="As fast as the processor allows, deterministic.")
@click.option(
    "--or-virtual",
    is_flag=True,
    help="If delays may have caused a fault, repeat the run with --virtual in OUT/virtual.",
)
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the lab's noise.")
@click.option("--serve", is_flag=True, help="Wait for `tonus ctl` instead of playing a scenario.")
@click.option("--socket", type=click.Path(path_type=Path), help="Control socket.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder; an earlier run in it moves to OUT/previous. Without it a new folder in out.",
)
@click.option("--view", is_flag=True, help="Show it in a browser: starts `tonus view` beside it.")
@click.option("--force", is_flag=True, help="Run even what `tonus check` refuses.")
@click.option("--json", "as_json", is_flag=True, help="Print summary.json and nothing else.")
def run(
    config: Path,
    scenario: str | None,
    duration: float | None,
    controller: str | None,
    *,
    settings_: tuple[str, ...],
    virtual: bool,
    or_virtual: bool,
    seed: int | None,
    serve: bool,
    socket: Path | None,
    out: Path | None,
    view: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Run CONFIG: bring the robot up, play a scenario, record everything, sum it up.

    Without --out each run has a folder of its own in out, and out/latest points to the newest.
    With --serve it waits for commands (`tonus ctl`) until it is interrupted; --out then names a
    folder in which each start has a numbered one.
    """
    if or_virtual and (serve or as_json):
        raise click.UsageError("--or-virtual plays a scenario twice: leave --serve or --json out")
    if not as_json:
        output.make_optional()
    overrides = overrides_of(settings_)
    if controller is not None:
        overrides["control.controller"] = controller
    settings, played = load(config, scenario, overrides)
    if duration is not None:
        played = played.model_copy(update={"duration": duration})
    if seed is None:
        seed = settings.lab.seed if settings.lab else 0
    if not force:
        _refuse(config, settings, played, timed=not virtual)
    say: Progress = (lambda _: None) if as_json else _say
    say(f"{settings.name}: {played.description}")
    others: tuple[Scenario, ...] = ()
    if serve:
        others = tuple(_others(config, settings, played, say=say, force=force))
    if out is None:
        folder = new_folder(config, "serve" if serve else played.name)
    else:
        folder = next_folder(out) if serve else out
    order = Order(
        settings,
        played,
        folder,
        seed,
        virtual,
        say,
        live=not as_json,
        serve=serve,
        others=others,
        socket=socket,
        link=out is None,
    )
    try:
        with beside(say) if view else nullcontext():
            good, disturbed = _play(order, as_json=as_json)
    finally:
        if out is None:
            discard_empty(folder)
    if or_virtual and disturbed:
        click.echo("\nrepeated in virtual time, which does not depend on the host:")
        again = replace(order, virtual=True, out=folder / "virtual", link=False)
        good, _ = _play(again, as_json=as_json)
    raise click.exceptions.Exit(0 if good else 1)


def _play(order: Order, *, as_json: bool) -> tuple[bool, bool]:
    """Whether it came to a good end, and whether delays may be why it did not."""
    result = carry_out(order)
    outcome = result.outcome
    ended_well = outcome.fault is Fault.NONE and not outcome.obstacle and not outcome.overrun
    good = ended_well and not result.unrecorded
    if order.serve or not outcome.ticks:  # ended while the bus was brought up: nothing to sum up
        _tell_served(result, as_json=as_json)
        return good, False
    try:
        summary = _summary(order, result)
        from tonus.tools.report.overview import overview  # matplotlib: not before the run

        picture = order.out / "overview.png"
        with drafted(picture) as beside:
            overview(open_log(result.log), order.config, beside)
    except (OSError, ToolError) as error:
        _tell_unsummed(result, error, as_json=as_json)
        return False, False
    disturbed = outcome.fault is not Fault.NONE and _disturbed(order.config, summary)
    if as_json:
        click.echo(json.dumps(summary, indent=2))
    else:
        files = [*segments(result.log), order.out / "summary.json", picture]
        _tell(summary, result, files, disturbed=disturbed)
    return good, disturbed


def _disturbed(config: Config, summary: Summary) -> bool:
    """Whether ticks came late, or the host took so much time that it may have been the lab's alone,
    whose nodes were silent then."""
    stolen = summary["steal_percent"] or 0.0
    late = summary["missed_ticks"] + summary["missed_by_host"]
    return late > 0 or stolen >= config.realtime.host.steal_bad_percent


def _tell_unsummed(result: Result, error: Exception, *, as_json: bool) -> None:
    """A run whose log holds too little for a summary, or whose disk has no room for one."""
    problem = result.unrecorded or str(error)
    if as_json:
        ended = {"state": result.outcome.state.name, "reason": result.outcome.reason}
        click.echo(json.dumps(ended | {"unrecorded": problem, "log": str(result.log)}, indent=2))
        return
    click.echo(f"  {'NOT RECORDED':<15} {problem}")
    click.echo(f"  {'folder':<15} {result.log.parent}")
    click.echo(f"{result.outcome.state.name}: {result.outcome.reason}")


def _tell_served(result: Result, *, as_json: bool) -> None:
    """Days of operation are not summed up: what is wanted of them `tonus log` finds."""
    outcome = result.outcome
    if as_json:
        ended = {"state": outcome.state.name, "reason": outcome.reason, "ticks": outcome.ticks}
        ended["unrecorded"] = result.unrecorded
        click.echo(json.dumps(ended | {"log": str(result.log)}, indent=2))
        return
    click.echo(f"  {'log':<15} {result.log}, {outcome.ticks} ticks")
    if result.unrecorded:
        click.echo(f"  {'NOT RECORDED':<15} {result.unrecorded}")
    click.echo(f"{outcome.state.name}: {outcome.reason}")


def _others(
    path: Path, config: Config, played: Scenario, *, say: Progress, force: bool
) -> Iterator[Scenario]:
    """What may be chosen beside the scenario played first, as far as the robot can do it."""
    for scenario in load_catalogue(path):
        if scenario.name == played.name:
            continue
        try:
            if not force:
                _refuse(path, config, scenario)
        except ToolError as error:
            say(f"scenario {scenario.name} cannot be chosen: {error}")
            continue
        yield scenario


def _refuse(path: Path, config: Config, scenario: Scenario, *, timed: bool = False) -> None:
    for finding in check(config, scenario, timed=timed):
        if not finding.ok:
            remedy = f"{finding.remedy}, or run all the same with --force"
            raise ToolError(f"{path}: {finding.where}: {finding.text}; {remedy}")


def _say(text: str) -> None:
    click.echo(f"  {text}")


def _summary(order: Order, result: Result) -> Summary:
    log = open_log(result.log)
    factor = result.realtime_factor(order.config.control.rates.period)
    summary = summarise(
        log,
        realtime_factor=round(factor, 3),
        steal_percent=result.steal_percent,
        reason=result.outcome.reason,
    )
    own, host = missed_in(log, State.ACTIVE)
    summary["active_missed_ticks"], summary["active_missed_by_host"] = own, host
    summary["unrecorded"] = result.unrecorded
    summary["refused"] = [str(grant) for grant in result.grants if not grant.granted]
    if result.latencies is not None:
        summary["histograms"] = buckets(result.latencies)
    path = order.out / "summary.json"
    write_whole(path, json.dumps(summary, indent=2) + "\n")
    return summary


def _largest_load(log: Log) -> tuple[float, float] | None:
    """Largest external force (N) in ACTIVE and the platform's distance from its reference then (m):
    an impedance yields by force over stiffness, and that is no error."""
    load, position = truth_at_cycles(log, "load"), truth_at_cycles(log, "position")
    active = log["/tonus/state"]["state"] == State.ACTIVE
    if load is None or position is None or not active.any():
        return None
    force = np.linalg.norm(load[active, :3], axis=1)
    if force.max() == 0.0:
        return None
    away = position[active] - log["/tonus/pose"]["desired_position"][active]
    at_most = force >= force.max() * (1.0 - 1e-9)
    return float(force.max()), float(np.linalg.norm(away[at_most], axis=1).max())


def _delays(summary: Summary) -> list[tuple[str, str]]:
    """Of a run in real time that ended in a fault."""
    own, host = summary["missed_ticks"], summary["missed_by_host"]
    stolen = summary["steal_percent"] or 0.0
    return [
        ("delays", f"{own + host} ticks missed, and {stolen:.1f} % of the time taken by the host;"),
        ("", "they may have caused the stop: tonus doctor lists what to change;"),
        ("", "--virtual does not depend on the host"),
    ]


def _tell(summary: Summary, result: Result, files: list[Path], *, disturbed: bool) -> None:
    """What a newcomer wants to see, the verdict last."""

    def span(key: str, unit: str) -> str:
        low, high = summary[key]["min"], summary[key]["max"]
        return f"{low:.0f} to {high:.0f} {unit}"

    rows = [
        ("time", f"{summary['ticks']} ticks at {summary['realtime_factor']:.2f} x real time"),
        ("missed ticks", f"{summary['missed_ticks']} own, {summary['missed_by_host']} by the host"),
    ]
    if result.latencies is not None:
        rows += latency_rows(summary)
    if summary["tracking_rmse_m"] is not None:
        rows.append(("position error", f"{summary['tracking_rmse_m'] * 1e3:.2f} mm RMS in ACTIVE"))
    load = _largest_load(open_log(result.log))
    if load is not None:
        rows.append(("under load", f"{load[1] * 1e3:.1f} mm away at {load[0]:.0f} N"))
    if summary["tension_rmse_n"] is not None:
        rows.append(("tension error", f"{summary['tension_rmse_n']:.2f} N RMS"))
    if summary["k_eq_n_per_m"] is not None:
        rows.append(("stiffness K_eq", span("k_eq_n_per_m", "N/m")))
        rows.append(("tensions", span("tension_n", "N")))
    if summary["contact_peak_n"] is not None:
        rows.append(("contact peak", f"{summary['contact_peak_n']:.1f} N"))
    if result.unrecorded:
        rows.append(("NOT RECORDED", f"a part of the run, at least its end: {result.unrecorded}"))
    if disturbed:
        rows += _delays(summary)
    click.echo()
    for name, value in rows:
        click.echo(f"  {name:<15} {value}")
    click.echo(f"  {'folder':<15} {result.log.parent}")
    click.echo(f"  {'files':<15} {'  '.join(file.name for file in files)}")
    click.echo(f"  {'see it again':<15} tonus view {result.log}")
    click.echo(f"{result.outcome.state.name}: {result.outcome.reason}")
