"""Logs side by side: Table 3's indicators, and ours, for any runs, with their spread.

A run in a lab is judged against its truth. A robot has none: its own measurements stand in, which
flatters whoever is wrong together with the sensors, so the table says so; and what takes the
plant's losses is left out.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

from tonus.config.schema.scenario import Scenario
from tonus.tools.errors import ToolError
from tonus.tools.log import Log
from tonus.tools.log.attached import configuration, played
from tonus.tools.paper.case import Kind
from tonus.tools.paper.compare import compared
from tonus.tools.paper.metrics import measure
from tonus.tools.paper.printed import OURS, TABLE3
from tonus.tools.paper.recorded import has_truth, recorded
from tonus.tools.paper.results import Results, Row
from tonus.tools.paper.table import Column, Table

_NEEDED = ("timing", "state", "pose", "stiffness", "tension", "wrench", "drives", "energy")
_LOSSES = frozenset(
    {"energy_dissipated", "energy_per_period", "efficiency_percent", "drive_efficiency_percent"}
)
"""indicators of what only a lab's plant tells"""


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
    trial = recorded(log, config, scenario)
    indicators = measure(trial)
    true = has_truth(log)
    if not true:
        indicators = {key: each for key, each in indicators.items() if key not in _LOSSES}
    row = Row(
        key=str(log.path),
        stage=0,
        case=scenario.name,
        kind=trial.run.case.kind,
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


def load_of(scenario: Scenario) -> str:
    """The scenario's external load in words; empty without one."""
    load = scenario.lab.load
    if load is None:
        return ""
    largest = max(load.profile, key=lambda point: abs(point.force))
    before = [point for point in load.profile if point.at < largest.at and point.force == 0.0]
    rise = largest.at - before[-1].at if before else 0.0
    return f"load of {abs(largest.force):g} N within {rise:g} s"
