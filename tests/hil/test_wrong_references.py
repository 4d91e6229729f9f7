"""Daemons whose recorded references fit their wrong torques: SUP-5 and SUP-8, on CAN, in virtual
time. What counts is what was reached by when the last drive lost the heartbeat."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.supervised import BRIEF, Run, configured
from tests.wrong_daemons import UPPER, Wrong, after, blind, both, stopped_in_time, torque_in_control
from tonus.config.loader import load_scenario
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.states import State

pytestmark = pytest.mark.wide

CASES = {
    "references beyond their bound in a stop": Wrong(
        State.SAFE_STOP,
        (600.0, 600.0),
        (600.0, 600.0),
        Requirement.OPPOSED,
        25.0,
        0.1,
        100.0,
    ),
    "of the upper cables alone": Wrong(
        State.SAFE_STOP, (690.0, 0.0), (600.0, 18.6), Requirement.OPPOSED, 25.0, 0.35, 100.0
    ),
    "torques far beyond their references in a stop": Wrong(
        State.SAFE_STOP, (690.0, 0.0), (199.0, 18.6), Requirement.OPPOSED, 40.0, 0.9, 120.0
    ),
    "torques within their references in a stop": Wrong(
        State.SAFE_STOP, (150.0, 0.0), (199.0, 18.6), Requirement.SPEED, 120.0, 0.75, 90.0
    ),
    "torques far beyond their references": Wrong(
        State.ACTIVE, (690.0, -690.0), (219.0, 18.6), Requirement.OPPOSED, 25.0, 0.7, 100.0
    ),
    "references of cables that are given up": Wrong(
        State.ACTIVE, (380.0, 380.0), (300.0, 300.0), Requirement.ORDERS, 25.0, 0.1, 100.0, True
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_references_that_fit_wrong_torques(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = CASES[name]
    config, _ = configured(**BRIEF)
    radius = np.array([train.drum.radius for train in config.robot.drive_trains])
    ticks = np.arange(8)

    def pulled(_: Any) -> Any:
        """Never equal to the last bit, which would be SUP-3."""
        ticks[:] += 1
        return np.where(UPPER, *wrong.torques) * radius + 0.02 * (ticks % 5 - 2)

    def recorded(record: Any, *_: Any) -> Any:
        record.tension.reference[...] = np.where(UPPER, *wrong.references)
        record.state.failed[...] |= wrong.failed
        return record

    def change() -> None:
        both(blind, torque_in_control(pulled), after(ControlCycle, "write", recorded))(monkeypatch)

    stop = wrong.state is State.SAFE_STOP
    scenario = load_scenario("hold" if stop else "sine_z")
    run = Run(config, scenario, change, state=wrong.state, at=0.1 if stop else 0.5)
    with monkeypatch.context():
        seen = run.play(0.5)
    monkeypatch.undo()
    stopped_in_time(wrong, run, seen)
