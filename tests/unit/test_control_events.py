"""Failures that the daemon tells of by itself."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from operated import Operated, told

from runtime.states import Fault, State


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Operated]:
    operated = Operated(tmp_path)
    yield operated
    operated.close()


def test_a_value_that_is_not_a_number_disables_every_drive(robot: Operated) -> None:
    robot.bring_to(State.HOLD)
    cycle, handled = robot.daemon.cycle, len(robot.history)
    cycle._wrench[:] = float("nan")
    cycle._finite = False
    robot.advance(1)
    after = robot.history[handled]
    assert (after.state, after.fault, after.enabled) == (State.FAULT, Fault.NOT_FINITE, False)
    assert told(robot.events, "not_finite") == [
        "a computed value was not a number; drives disabled at once"
    ]


def test_a_wrench_out_of_reach_is_told_once_an_episode(robot: Operated) -> None:
    robot.until(State.STANDBY)
    deficit = robot.daemon.cycle.record.wrench.deficit
    for newtons in (5.0, 5.0, 0.0, 5.0):
        deficit[...] = newtons
        robot.advance(5)
    assert (
        told(robot.events, "wrench_deficit")
        == ["5.0 N of the commanded wrench cannot be delivered"] * 2
    )


def test_a_reset_says_whose_it_was(robot: Operated) -> None:
    robot.bring_to(State.FAULT)
    assert robot.command("reset", 20)["ok"]
    assert "reset by " in told(robot.events, "operator")[-1]
