"""What a set of gains costs: one number, the same for every controller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.config.schema.tuning import Tuning
from tonus.runtime.control.reference import trajectory
from tonus.runtime.states import Fault
from tonus.tools.margins.observer import CUT, observer_margins
from tonus.tools.margins.task import margins
from tonus.tools.margins.tension_loop import Margins
from tonus.tools.tune.trial import Trial, play

Array = NDArray[np.float64]
CUTS = ("torque", "force")


@dataclass(frozen=True)
class Part:
    """One scenario's share of the cost, and what it is made of."""

    scenario: str
    cost: float
    position: float | None
    """m RMS, None where something is touched"""
    force: float | None
    """N RMS, None where nothing is"""
    effort: float
    """N m RMS a tick"""
    fault: str | None = None


def all_margins(config: Config, controller: str) -> dict[str, Margins]:
    """By where the loop is cut: those that the floors are for."""
    found = {cut: margins(config, controller, cut=cut) for cut in CUTS}
    of_observer = observer_margins(config, controller)
    return found if of_observer is None else found | {CUT: of_observer}


def lack(config: Config, controller: str) -> float:
    """How far the margins are below their floors at the worst, as a share of the floor; none: 0.
    Unstable loops lack more than any other."""
    loop, worst = config.control.tension_loop, 0.0
    for found in all_margins(config, controller).values():
        if not found.stable:
            return 2.0
        worst = max(worst, 1.0 - found.least_gain_db / loop.gain_margin_db)
        worst = max(worst, 1.0 - found.phase_deg / loop.phase_margin_deg)
    return min(worst, 1.9)


def judge(tuning: Tuning, config: Config, seed: int) -> list[Part]:
    """Every scenario played once, the noise and the plant drawn from ``seed``."""
    return [
        _part(tuning, scenario, play(config, scenario, seed=seed)) for scenario in tuning.scenarios
    ]


def _part(tuning: Tuning, scenario: Scenario, trial: Trial) -> Part:
    if trial.fault is not Fault.NONE or len(trial.time) < 2:
        name = trial.fault.name.lower() if trial.fault is not Fault.NONE else "never active"
        return Part(scenario.name, tuning.failure, None, None, 0.0, name)
    cost, off, lacking = tuning.cost, None, None
    effort = _rms(np.diff(trial.cycle["drives"]["torque_command"], axis=0))
    total = cost.effort.weight * effort / cost.effort.scale
    if scenario.lab.phantom is None:
        off = _rms(np.linalg.norm(trial.error, axis=1))
        total += cost.position.weight * off / cost.position.scale
    else:
        lacking = _rms(trial.truth["contact_force"] - _asked(scenario, trial))
        total += cost.force.weight * lacking / cost.force.scale
    return Part(scenario.name, total, off, lacking, effort)


def _asked(scenario: Scenario, trial: Trial) -> Array:
    """N at the contact port, by the scenario's own time."""
    wanted, time = trajectory(scenario.reference), trial.cycle["state"]["scenario_time"]
    return np.array([float(np.linalg.norm(wanted.push(float(t)))) for t in time])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
