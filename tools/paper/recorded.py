"""The trial that a log holds, of any run: its ACTIVE part, as the paper's indicators are taken of.

A robot has no truth. Its own measurements stand in, and what only a plant tells is zero.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Path, Press, Scenario, Sine
from tonus.runtime.states import State
from tonus.tools.errors import ToolError
from tonus.tools.log import Log
from tonus.tools.paper.case import Case, Kind, Run
from tonus.tools.paper.metrics import NEEDED_CYCLE, NEEDED_TRUTH
from tonus.tools.paper.trial import Trial
from tonus.tools.run.summary import find_faults

TRUTH = "/tonus/truth"
_AT_ONCE_S = 0.02
"""s in which a load that rises is a step: the loop's own response takes longer"""


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


def has_truth(log: Log) -> bool:
    """Whether it is a lab's."""
    return TRUTH in log and len(log[TRUTH]) > 0


def recorded(log: Log, config: Config, scenario: Scenario) -> Trial:
    """The ACTIVE part of a log. Raises `ToolError`."""
    active = np.flatnonzero(log["/tonus/state"]["state"] == State.ACTIVE)
    if not len(active):
        raise ToolError(f"{log.path}: the run was never ACTIVE; there is nothing to compare")
    case = Case(0, scenario.name, kind_of(scenario), scenario)
    stamps = log.times("/tonus/timing")
    cycle = {name: _field(log, name)[active] for name in NEEDED_CYCLE}
    if has_truth(log):
        nearest = np.searchsorted(log.times(TRUTH), stamps[active]).clip(0, len(log[TRUTH]) - 1)
        truth = {name: log[TRUTH][name][nearest] for name in NEEDED_TRUTH}
    else:
        truth = _measured(log, active, config)
    faults = find_faults(log)
    return Trial(
        run=Run(case, config.control.controller, "lab", 1, "direct"),
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
