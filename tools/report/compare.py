"""Logs side by side: Table 3's indicators, and ours, for any runs, with their spread.

A run in a lab is judged against its truth. A robot has none: its own measurements stand in, which
flatters whoever is wrong together with the sensors, so the table says so; and what takes the
plant's losses is left out.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Path, Press, Scenario, Sine
from tonus.runtime.states import State
from tonus.tools.errors import ToolError
from tonus.tools.log import Log
from tonus.tools.log.attached import configuration, played
from tonus.tools.paper.case import Case, Kind, Run
from tonus.tools.paper.compare import compared
from tonus.tools.paper.metrics import NEEDED_CYCLE, NEEDED_TRUTH, measure
from tonus.tools.paper.printed import OURS, TABLE3
from tonus.tools.paper.results import Results, Row
from tonus.tools.paper.table import Column, Table
from tonus.tools.paper.trial import Trial
from tonus.tools.run.summary import find_faults

TRUTH = "/tonus/truth"
_NEEDED = ("timing", "state", "pose", "stiffness", "tension", "wrench", "drives", "energy")
_LOSSES = frozenset(
    {"energy_dissipated", "energy_per_period", "efficiency_percent", "drive_efficiency_percent"}
)
"""indicators of what only a lab's plant tells"""
_AT_ONCE_S = 0.02
"""s in which a load that rises is a step: the loop's own response takes longer"""


@dataclass(frozen=True)
class Judged:
    """One log: its figures, and what they were taken against."""

    log: Log
    row: Row
    against: str
    """truth, or its own measurements"""
    settings: int
    """checksum of its controller's settings"""


def compare(logs: Sequence[Log]) -> tuple[Table, list[Judged]]:
    """A column for each controller (and each set of its gains), a row for each indicator that any
    log has: mean and standard deviation over logs of the same scenarios.

    Raises `ToolError` for a log without configuration, scenario or a tick in ACTIVE.
    """
    judged = _labelled([_judge(log) for log in logs])
    results = Results([each.row for each in judged])
    names = results.names("controller")
    columns = [Column("indicator"), Column("unit"), *(Column(name) for name in names)]
    table = Table("compare", "Indicators of Table 3, and ours", tuple(columns))
    missing = []
    for indicator in (*(row[0] for row in TABLE3), *OURS):
        found = compared(results, indicator)
        if not found.values:
            kinds = " or ".join(sorted(kind.value for kind in indicator.kinds))
            missing.append(f"{indicator.symbol} ({kinds})")
            continue
        label = f"{_as_played(indicator.label)} {indicator.symbol}"
        table.rows.append([label, indicator.unit, *(found.spread(name) for name in names)])
        best = found.best()
        if best is not None and len(found.values) > 1 and indicator.key != "k_eq_mean":
            table.marked.add((len(table.rows) - 1, names.index(best) + 2))
    table.notes.append("bold: best. ±: standard deviation over logs")
    if any(each.row.kind is Kind.SINE for each in judged):
        table.notes.append(
            "RMSE_x is taken over whole periods after the fade-in, as Table 3 asks; "
            "tracking_rmse_m of summary.json over all of ACTIVE"
        )
    if missing:
        table.notes.append(f"no log, or not every controller, has: {', '.join(missing)}")
    for against in sorted({each.against for each in judged}):
        count = sum(each.against == against for each in judged)
        table.notes.append(f"judged against {against}: {count} of {len(judged)} logs")
    return table, judged


def _as_played(label: str) -> str:
    """The protocol's loads have sizes in their names; any run's may be another."""
    return label.replace("25 N step", "Load step").replace("100 N ramp", "Load ramp")


def _judge(log: Log) -> Judged:
    config, scenario = configuration(log), played(log)
    for topic in _NEEDED:
        if f"/tonus/{topic}" not in log:
            raise ToolError(f"{log.path}: there is no topic /tonus/{topic}; compare runs of tonus")
    controller = config.control.controller
    run = Run(Case(0, scenario.name, kind_of(scenario), scenario), controller, "lab", 1, "direct")
    trial = _trial(log, run, config)
    indicators = measure(trial)
    true = TRUTH in log and len(log[TRUTH]) > 0
    if not true:
        indicators = {key: each for key, each in indicators.items() if key not in _LOSSES}
    row = Row(
        key=str(log.path),
        stage=0,
        case=scenario.name,
        kind=run.case.kind,
        controller=controller,
        plant="lab",
        seed=1,
        bus="direct",
        indicators=indicators,
        state=trial.state,
        reason=trial.reason,
        fault=trial.fault,
    )
    settings = zlib.crc32(config.control.model_dump_json().encode())
    return Judged(log, row, "truth" if true else "the robot's own measurements", settings)


def _labelled(judged: list[Judged]) -> list[Judged]:
    """Controllers of one name with unlike settings get a number; logs of one controller and one
    scenario are told apart as repetitions."""
    kinds: dict[str, list[int]] = {}
    for each in judged:
        seen = kinds.setdefault(each.row.controller, [])
        if each.settings not in seen:
            seen.append(each.settings)
    repeated: dict[tuple[str, str], int] = {}
    found = []
    for each in judged:
        name = each.row.controller
        if len(kinds[name]) > 1:
            name = f"{name} {kinds[name].index(each.settings) + 1}"
        number = repeated[name, each.row.case] = repeated.get((name, each.row.case), 0) + 1
        found.append(replace(each, row=replace(each.row, controller=name, seed=number)))
    return found


def kind_of(scenario: Scenario) -> Kind:
    """What a scenario asks, told from what is in it."""
    lab, reference = scenario.lab, scenario.reference
    if isinstance(reference, Press):
        return Kind.PRESS
    if lab.load is not None:
        rising = [
            later.at - former.at
            for former, later in zip(lab.load.profile, lab.load.profile[1:], strict=False)
            if abs(later.force) > abs(former.force)
        ]
        return Kind.STEP if rising and max(rising) <= _AT_ONCE_S else Kind.RAMP
    if lab.phantom is not None:
        return Kind.CONTACT
    if isinstance(reference, Sine):
        return Kind.SINE
    return Kind.MOVE if isinstance(reference, Path) else Kind.HOLD


def load_of(scenario: Scenario) -> str:
    """The scenario's external load in words; empty without one."""
    load = scenario.lab.load
    if load is None:
        return ""
    largest = max(load.profile, key=lambda point: abs(point.force))
    before = [point for point in load.profile if point.at < largest.at and point.force == 0.0]
    rise = largest.at - before[-1].at if before else 0.0
    return f"load of {abs(largest.force):g} N within {rise:g} s"


def _trial(log: Log, run: Run, config: Config) -> Trial:
    """The ACTIVE part of a log. Raises `ToolError`."""
    active = np.flatnonzero(log["/tonus/state"]["state"] == State.ACTIVE)
    if not len(active):
        raise ToolError(f"{log.path}: the run was never ACTIVE; there is nothing to compare")
    stamps = log.times("/tonus/timing")
    cycle = {name: _field(log, name)[active] for name in NEEDED_CYCLE}
    if TRUTH in log and len(log[TRUTH]):
        nearest = np.searchsorted(log.times(TRUTH), stamps[active]).clip(0, len(log[TRUTH]) - 1)
        truth = {name: log[TRUTH][name][nearest] for name in NEEDED_TRUTH}
    else:
        truth = _measured(log, active, config)
    faults = find_faults(log)
    return Trial(
        run=run,
        config=config,
        time=(stamps[active] - stamps[active[0]]) * 1e-9,
        cycle=cycle,
        truth=truth,
        state=State(int(log["/tonus/state"]["state"][-1])).name,
        reason=str(faults[-1]["name"]) if faults else "completed",
        fault=str(faults[-1]["name"]) if faults else "",
        ticks=len(stamps),
    )


def _field(log: Log, name: str) -> NDArray[Any]:
    topic, field = name.split(".")
    rows = log[f"/tonus/{topic}"]
    if field not in (rows.dtype.names or ()):
        raise ToolError(f"{log.path}: an older log, without {name}; record the run again")
    return np.asarray(rows[field])


def _measured(log: Log, active: NDArray[np.intp], config: Config) -> dict[str, NDArray[Any]]:
    """What the robot measured in the place of truth; zero where it measures nothing."""
    pose, wrench = log["/tonus/pose"][active], log["/tonus/wrench"][active]
    drives = log["/tonus/drives"][active]
    per_ampere = config.robot.torque_per_amp
    absent = ("contact_penetration", "platform_power", "electrical_power")
    losses = ("friction_losses", "cable_losses", "copper_losses")
    return {
        **{name: pose[name] for name in ("position", "quaternion", "velocity")},
        "tension": log["/tonus/tension"]["measured"][active],
        "drum_rate": drives["rate"],
        "current": drives["torque"] / per_ampere,
        "load": wrench["external"],
        "contact_force": wrench["contact"],
        **{name: np.zeros(len(active)) for name in (*absent, *losses)},
    }
