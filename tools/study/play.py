"""One run of a study, and the row that it becomes."""

from __future__ import annotations

import shutil
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from tonus.config.errors import ConfigError
from tonus.config.schema.parameter_study import Measure, ParameterStudy
from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.drivers.errors import DriverError
from tonus.runtime.daemon import Outcome
from tonus.runtime.errors import DaemonError
from tonus.runtime.states import Fault, State
from tonus.runtime.timing import clock
from tonus.sim.errors import LabError
from tonus.tools.campaign.play import describe
from tonus.tools.errors import ToolError
from tonus.tools.expect import Run
from tonus.tools.log import open as open_log
from tonus.tools.log.log import Log
from tonus.tools.run.composer import run
from tonus.tools.run.order import Order
from tonus.tools.run.summary import Indicators, truth_at_cycles
from tonus.tools.study.indicators import taken
from tonus.tools.study.provenance import configuration_digest, loaded
from tonus.tools.study.trials import Trial

Row = dict[str, Any]
COMPLETED = "completed"
SECONDS = "seconds"
"""of wall time; a row has it in the journal, and not in the table, which is the same everywhere"""
FIGURES = {
    "tracking_rms_mm": "true position less the desired one in ACTIVE",
    "tracking_max_mm": "its largest",
    "displacement_mm": "largest distance from the desired position while a load pulls",
    "load_peak_n": "largest load",
    "compliance_mm_per_n": "displacement at the largest load over that load",
    "tension_error_rms_n": "true tensions less their references in HOLD and ACTIVE",
    "tension_min_n": "least true tension in HOLD and ACTIVE",
    "tension_max_n": "largest",
    "stiffness_min_n_per_m": "least K_eq in HOLD and ACTIVE",
    "stiffness_max_n_per_m": "largest",
    "contact_peak_n": "largest contact force of the run",
    "effort_rms_nm": "change of the torques from tick to tick in ACTIVE",
}
"""of every run, by name; None where a run does not have it"""
_PARTS = ("timing", "state", "pose", "stiffness", "tension", "wrench", "drives", "envelope")
_READ = tuple(f"/tonus/{part}" for part in (*_PARTS, "energy", "truth"))
"""topics that most figures are of: one pass over the log instead of one for each"""


def figures(study: ParameterStudy) -> tuple[str, ...]:
    """Of every run of this study, by name."""
    return (*FIGURES, *study.indicators, *study.measures)


def play(study: ParameterStudy, trial: Trial, folder: Path) -> Row:
    """Run it in virtual time in ``folder``, which stays where the study keeps such logs. Whatever
    is wrong with a run is its verdict: a fault's name, or ``error`` with a line."""
    began = clock.wall_seconds()
    try:
        row = _played(study, trial, folder)
    except Exception as error:  # noqa: BLE001 - of a controller or a model: a row, not the end
        row = failed(study, trial, caught(error))
    kept = study.keep == "all" or (study.keep == "failures" and row["verdict"] != COMPLETED)
    if not kept:
        shutil.rmtree(folder, ignore_errors=True)
    return row | {SECONDS: round(clock.wall_seconds() - began, 3)}


def caught(error: Exception) -> str:
    """What ended a run: in its own words where they are meant for a user, else with its place."""
    if isinstance(error, (ConfigError, ToolError, LabError, DriverError, DaemonError, OSError)):
        return str(error) or type(error).__name__
    return describe(error)


def failed(study: ParameterStudy, trial: Trial, reason: str) -> Row:
    """The row of a run that has no figures."""
    none = dict.fromkeys(figures(study))
    return _row(study, trial, "error", reason.splitlines()[0], 0, "") | none


def _row(
    study: ParameterStudy, trial: Trial, verdict: str, reason: str, ticks: int, digest: str
) -> Row:
    return {
        "index": trial.index,
        "config": trial.config,
        "scenario": trial.scenario,
        "controller": trial.controller,
        "seed": trial.seed,
        "parameters": trial.parameters,
        "verdict": verdict,
        "reason": reason,
        "ticks": ticks,
        "digest": digest,
        "configuration": "",
        "command": trial.command(study),
    }


def _played(study: ParameterStudy, trial: Trial, folder: Path) -> Row:
    config, scenario = loaded(study, trial)
    order = Order(config, scenario, folder, trial.seed, True, lambda _: None, live=False)
    result = run(order)
    log = open_log(result.log)
    log.load([topic for topic in _READ if topic in log])
    return row_of(study, trial, config, scenario, result.outcome, log, result.unrecorded)


def row_of(
    study: ParameterStudy,
    trial: Trial,
    config: Config,
    scenario: Scenario,
    outcome: Outcome,
    log: Log,
    unrecorded: str = "",
) -> Row:
    """What a run came to. ``unrecorded``: why the log ends before it."""
    verdict = COMPLETED if outcome.fault is Fault.NONE else outcome.fault.name.lower()
    if outcome.obstacle or unrecorded:
        verdict = "error"
    reason = unrecorded or outcome.obstacle or outcome.reason
    row = _row(study, trial, verdict, reason, outcome.ticks, _digest(log))
    row["configuration"] = configuration_digest(config, scenario)
    questions = Run(log, reason=reason)
    if study.indicators:
        row |= taken(log, config, scenario, study.indicators)
    return row | _figures(log) | {key: _taken(questions, m) for key, m in study.measures.items()}


def _digest(log: Log) -> str:
    """Of every command that the run gave, to compare a repetition with."""
    told = sha256(log["/tonus/drives"]["torque_command"].tobytes())
    return told.hexdigest()[:16]


def _figures(log: Log) -> Row:
    indicators = Indicators()
    indicators.add(log)
    told = indicators.told()
    active = log["/tonus/state"]["state"] == State.ACTIVE
    position, pull = truth_at_cycles(log, "position"), truth_at_cycles(log, "load")
    assert position is not None  # a lab has its truth
    assert pull is not None
    away = np.linalg.norm(position - log["/tonus/pose"]["desired_position"], axis=1)[active]
    load = np.linalg.norm(pull[:, :3], axis=1)[active]
    torque = np.diff(log["/tonus/drives"]["torque_command"][active], axis=0)
    found: Row = dict.fromkeys(FIGURES)
    tension, stiffness = told["tension_n"] or {}, told["k_eq_n_per_m"] or {}
    found["tension_error_rms_n"] = told["tension_rmse_n"]
    found["tension_min_n"], found["tension_max_n"] = tension.get("min"), tension.get("max")
    found["stiffness_min_n_per_m"] = stiffness.get("min")
    found["stiffness_max_n_per_m"] = stiffness.get("max")
    found["contact_peak_n"] = told["contact_peak_n"]
    if len(away):
        found["tracking_rms_mm"] = told["tracking_rmse_m"] * 1e3
        found["tracking_max_mm"] = float(away.max()) * 1e3
    if len(torque):
        found["effort_rms_nm"] = float(np.sqrt((torque**2).mean()))
    if len(load) and load.max() > 0.0:
        peak = int(load.argmax())
        found["displacement_mm"] = float(away[load > 0.0].max()) * 1e3
        found["load_peak_n"] = float(load[peak])
        found["compliance_mm_per_n"] = float(away[peak]) * 1e3 / float(load[peak])
    return found


def _taken(run: Run, measure: Measure) -> float | None:
    """None where the run was in none of the states."""
    signal = run.signal(measure.topic, measure.field).during(*measure.during)
    if measure.index is not None:
        signal = signal[measure.index]
    if measure.norm:
        signal = signal.norm()
    if not signal.values.size:
        return None
    if measure.take == "rms":
        return signal.rms()
    if measure.take == "last":
        signal = signal.norm() if signal.values.ndim > 1 else signal
        return float(signal.values[-1])
    found = getattr(signal.values, measure.take)()
    return float(found)
