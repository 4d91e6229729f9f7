"""Failures that the daemon tells of by itself."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from operated import Operated, told

from tonus.runtime.control.controllers.base import Controller
from tonus.runtime.states import Fault, State


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Operated]:
    operated = Operated(tmp_path)
    yield operated
    operated.close()


def test_a_value_that_is_not_a_number_ends_in_a_passive_stop(
    robot: Operated, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot.bring_to(State.HOLD)
    handled = len(robot.history)
    nothing = np.full(6, np.nan)
    monkeypatch.setattr(Controller, "wrench", lambda *_: nothing.copy())
    robot.advance(2)
    after = robot.history[handled + 1]
    assert (after.state, after.fault, after.enabled) == (State.SAFE_STOP, Fault.NOT_FINITE, True)
    assert told(robot.events, "not_finite") == ["a computed value was not a number; passive stop"]
    assert told(robot.events, "stop_mode") == [
        "passive: each drum by itself, with low tension and damping"
    ]
    robot.until(State.FAULT)


def test_a_wrench_out_of_reach_is_told_once_an_episode(
    robot: Operated, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot.bring_to(State.HOLD)
    within = Controller.wrench
    beyond = np.array([5000.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    for wrench in (lambda *_: beyond.copy(), within, lambda *_: beyond.copy()):
        monkeypatch.setattr(Controller, "wrench", wrench)
        robot.advance(5)
        deficit = float(robot.daemon.cycle.record.wrench.deficit)
        assert (deficit > 100.0) is (wrench is not within)
    texts = told(robot.events, "wrench_deficit")
    assert len(texts) == 2
    assert all(text.endswith(" N of the commanded wrench cannot be delivered") for text in texts)


def test_a_reset_says_whose_it_was(robot: Operated) -> None:
    robot.bring_to(State.FAULT)
    assert robot.command("reset", 20)["ok"]
    assert "reset by " in told(robot.events, "operator")[-1]
