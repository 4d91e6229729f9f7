"""A run of commands, choices and a tuned gain, given through the socket while it goes on, replays
bit for bit."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.composed import configured
from tonus.config.loader import load_scenario
from tonus.runtime.states import State
from tonus.runtime.timing import clock
from tonus.tools.control_client import ControlClient
from tonus.tools.log import Log
from tonus.tools.log import open as open_log
from tonus.tools.log.replay import replay
from tonus.tools.run.composer import Order, run

pytestmark = pytest.mark.wide

NAMES = ("sine_x", "sine_z")


class Person(threading.Thread):
    """Operates a daemon from outside its time, and ends it."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path
        self.replies: list[dict[str, Any]] = []
        self.trouble: BaseException | None = None

    def run(self) -> None:
        try:
            with ControlClient(self._path) as daemon:
                self._until(daemon, "STANDBY")
                self._say(daemon, "arm")
                self._until(daemon, "HOLD")
                self._say(daemon, "scenario", name="sine_x")
                self._say(daemon, "start")
                self._until(daemon, "ACTIVE", scenario_s=0.2)
                self._say(daemon, "set", key="control.stiffness.velocity_gain", value=0.4)
                self._until(daemon, "ACTIVE", scenario_s=0.4)
                self._say(daemon, "hold")
                self._until(daemon, "HOLD", elapsed_s=0.15)
                self._say(daemon, "scenario", name="sine_z")
                self._say(daemon, "start")
                self._until(daemon, "ACTIVE", elapsed_s=0.3)
                self._say(daemon, "stop")
        except (AssertionError, OSError) as error:
            self.trouble = error
        os.kill(os.getpid(), signal.SIGTERM)

    def _say(self, daemon: ControlClient, op: str, **fields: Any) -> None:
        reply = daemon.ask(op, **fields)
        assert reply["ok"], reply
        self.replies.append(reply)

    def _until(self, daemon: ControlClient, state: str, **least: float) -> None:
        for _ in range(3000):
            told = daemon.ask("status")
            if told["state"] == state and all(told[key] >= least[key] for key in least):
                return
            clock.pause(0.01)
        raise AssertionError(f"never in {state}: {told}")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    folder = tmp_path_factory.mktemp("choices")
    config, scenario = configured(
        "config/direct.yaml",
        overrides={"operation.socket.rate_hz": 1000.0, "recording.keyframe_s": 1.0},
    )
    path = folder / "tonus.sock"
    order = Order(
        config,
        scenario,
        folder,
        1,
        True,
        lambda _: None,
        live=False,
        serve=True,
        others=tuple(load_scenario(name) for name in NAMES),
        socket=path,
    )
    person = Person(path)

    def begin() -> None:
        while not path.exists():
            clock.pause(0.01)
        person.start()

    starting = threading.Thread(target=begin)
    starting.start()
    result = run(order)
    starting.join()
    person.join()
    assert person.trouble is None
    assert result.outcome.state is State.STANDBY
    return open_log(result.log)


def test_the_log_tells_what_was_chosen_when(log: Log) -> None:
    state = log["/tonus/state"]
    assert state["select"][state["select"] > 0].tolist() == [2, 3]
    assert np.unique(state["scenario"]).tolist() == [0, 1, 2]
    assert (np.diff(state["scenario"].astype(int)) >= 0).all()
    chosen = [event.text for event in log.events() if event.name == "operator"]
    assert sum(text.startswith("scenario ") for text in chosen) == 2


def test_the_log_tells_what_was_tuned_when_and_by_whom(log: Log) -> None:
    tuning = log["/tonus/tuning"]
    changed = np.flatnonzero(tuning["parameter"])
    assert tuning["value"][changed].tolist() == [0.4]
    (event,) = (each for each in log.events() if each.name == "tuned")
    assert event.tick == log["/tonus/timing"]["tick"][changed[0]]
    assert event.text.startswith("from 0.32 to 0.4 by ")
    assert tuning["gains"][-1, 1] == 0.4


def test_every_bit_comes_out_again(log: Log) -> None:
    again = replay(log)
    assert again.first is None, again.first
    assert again.ticks == len(log["/tonus/state"])


def test_so_it_does_from_a_keyframe_after_a_choice(log: Log) -> None:
    ticks = log["/tonus/timing"]["tick"]
    after = int(ticks[log["/tonus/state"]["scenario"] == 2][0]) + 1100
    if after >= int(ticks[-1]):
        after = int(ticks[-1]) - 10
    again = replay(log, first=after)
    assert again.keyframes
    assert again.first is None, again.first


def test_nothing_jumps_on_the_way_home_to_another_scenario(log: Log) -> None:
    state, pose = log["/tonus/state"], log["/tonus/pose"]
    moving = np.isin(state["state"], (State.HOLD, State.ACTIVE))
    desired = pose["desired_position"][moving]
    step = np.abs(np.diff(desired, axis=0)).max()
    assert step < 0.3e-3, "m in a tick: 0.3 m/s"
    assert np.abs(np.diff(pose["desired_velocity"][moving], axis=0)).max() < 3e-3
