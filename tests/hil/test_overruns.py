"""Missed ticks in a whole run, and what each policy makes of them. The host is a pacing that wakes
the daemon late; time is virtual."""

from __future__ import annotations

import asyncio
from pathlib import Path

import numpy as np
import pytest

from tests.composed import configured
from tonus.config import load
from tonus.config.schema.realtime import Overrun, RealTime
from tonus.runtime.states import Operator, State
from tonus.runtime.timing.clock import now_ns
from tonus.runtime.timing.overruns import Overruns
from tonus.tools.log import Log
from tonus.tools.log import open as open_log
from tonus.tools.log.replay import replay
from tonus.tools.run.composer import Order, Result, run

LATE_AT_NS = 2_800_000_000
LATE_NS = 4_300_000
TICKS = 4


class LateOnce:
    """A host that is late once, when the robot is ACTIVE."""

    async def until(self, due_ns: int) -> None:
        late = LATE_NS if due_ns == LATE_AT_NS else 0
        await asyncio.sleep((due_ns + late - now_ns()) * 1e-9)

    def steer(self, due_ns: int) -> int:
        return 0

    def close(self) -> None:
        pass


def played(tmp_path: Path, policy: str) -> tuple[Result, Log]:
    over = {"realtime.overrun": policy}
    config, scenario = configured("config/direct.yaml", "sine_x", duration=1.0, overrides=over)
    order = Order(config, scenario, tmp_path, 1, True, lambda _: None, live=False, pacing=LateOnce)
    result = run(order)
    log = open_log(result.log)
    assert (result.outcome.misses.own, result.outcome.misses.host) == (0, TICKS)
    at = np.flatnonzero(np.diff(log["/tonus/timing"]["tick"].astype(np.int64)) > 1)
    assert len(at) == 1, "ticks that were missed are not made up for"
    assert log["/tonus/state"]["state"][at[0]] == State.ACTIVE
    return result, log


def commands(log: Log) -> list[Operator]:
    said = log["/tonus/state"]["operator"]
    return [Operator(int(command)) for command in said[said != 0]]


def overruns(log: Log) -> list[str]:
    return [event.text for event in log.events() if event.name == "overrun"]


def test_skip_goes_on_as_if_nothing_had_been(tmp_path: Path) -> None:
    result, log = played(tmp_path, "skip")
    assert commands(log) == [Operator.ARM, Operator.START, Operator.STOP]
    assert result.outcome.reason == "scenario completed"
    assert not overruns(log)


def test_hold_keeps_the_platform_until_it_is_started_again(tmp_path: Path) -> None:
    result, log = played(tmp_path, "hold")
    expected = [Operator.ARM, Operator.START, Operator.HOLD, Operator.START, Operator.STOP]
    assert commands(log) == expected
    assert len(overruns(log)) == 1
    assert "4 ticks missed at once" in overruns(log)[0]
    assert not result.outcome.overrun
    assert replay(log).first is None


def test_stop_is_a_controlled_stop_and_says_why(tmp_path: Path) -> None:
    result, log = played(tmp_path, "stop")
    assert commands(log) == [Operator.ARM, Operator.START, Operator.STOP]
    assert log["/tonus/state"]["scenario_time"].max() < 0.9
    assert result.outcome.state is State.STANDBY
    assert result.outcome.overrun
    assert "ticks were missed" in result.outcome.reason
    assert len(overruns(log)) == 1


def settings(overrun: Overrun, ticks: int = 1) -> RealTime:
    return load("config/can.yaml")[0].realtime.model_copy(
        update={"overrun": overrun, "overrun_ticks": ticks}
    )


def test_fewer_ticks_than_configured_are_no_overrun() -> None:
    overruns = Overruns(settings("stop", 3))
    assert overruns.answer(2, State.ACTIVE, Operator.NONE) is Operator.NONE
    assert overruns.answer(3, State.ACTIVE, Operator.NONE) is Operator.STOP
    assert overruns.stopped
    assert overruns.answer(0, State.STANDBY, Operator.ARM) is Operator.ARM
    assert not overruns.stopped


@pytest.mark.parametrize("overrun", ["skip", "hold", "stop"])
@pytest.mark.parametrize("state", list(State))
@pytest.mark.parametrize("said", list(Operator))
def test_no_policy_arms_starts_or_outvotes_a_stop(
    overrun: Overrun, state: State, said: Operator
) -> None:
    answer = Overruns(settings(overrun)).answer(5, state, said)
    assert answer in (said, Operator.HOLD, Operator.STOP)
    if said in (Operator.STOP, Operator.ESTOP, Operator.RESET, Operator.ARM):
        assert answer is said
    if state in (State.OFF, State.STANDBY, State.FAULT):
        assert answer is said
