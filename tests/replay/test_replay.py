"""A log is enough to compute every output of its run again, to the last bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from loop import QUICK
from replay.altered import altered

from tonus.runtime.control.controllers import CONTROLLERS
from tonus.runtime.signals import Solver
from tonus.runtime.states import Operator, State
from tonus.tools.cli.log import log as log_command
from tonus.tools.errors import ToolError
from tonus.tools.log import Log
from tonus.tools.log import open as open_log
from tonus.tools.log.replay import replay
from tonus.tools.testing.player import Player

pytestmark = [
    pytest.mark.tonus(
        config="config/direct.yaml",
        overrides=QUICK | {"recording.raw_frames": False, "recording.keyframe_s": 0.8},
    ),
    pytest.mark.tonus_expect("*"),
]
SCENARIOS = sorted(path.stem for path in Path("config/scenarios").glob("*.yaml"))
EVERY = [
    pytest.param(
        SCENARIOS[k % len(SCENARIOS)],
        list(CONTROLLERS)[k % len(CONTROLLERS)],
        marks=[] if k % 8 == 1 else [pytest.mark.long],
    )
    for k in range(max(len(SCENARIOS), len(CONTROLLERS)))
]
"""each of both at least once"""
FIRST = 200
INPUTS = {
    "/tonus/drives": ("angle", "torque", "age", "statusword", "error_code", "state"),
    "/tonus/force_cells": ("raw", "age", "status"),
    "/tonus/tracker": ("position", "quaternion", "delay", "sequence", "fresh"),
}


@pytest.fixture(scope="module")
def sine(tonus_shared_run: Player) -> Log:
    return tonus_shared_run("sine_x", config="config/can.yaml", controller="bio", duration=0.2).log


@pytest.fixture(scope="module")
def beginning(sine: Log, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its first ticks alone, which replay in no time."""
    out = tmp_path_factory.mktemp("first") / "run.mcap"
    return altered(sine.path, out, lambda _topic, _rows, sequence: sequence < FIRST)


@pytest.mark.wide
@pytest.mark.parametrize(("scenario", "controller"), EVERY)
def test_every_output_comes_out_again(tonus_run: Player, scenario: str, controller: str) -> None:
    tonus_run(scenario, controller=controller, duration=0.2).replays()


def test_a_replay_may_begin_at_any_keyframe(sine: Log) -> None:
    ticks = sine["/tonus/keyframe"]["tick"].astype(int)
    states = set()
    for tick in ticks:
        found = replay(sine, first=int(tick) + 1, last=int(tick) + 150)
        assert found.keyframes == [tick]
        assert found.first is None, found.first
        states.add(int(sine["/tonus/state"]["state"][tick]))
    assert {State.ACTIVE, State.SAFE_STOP, State.PRETENSION} & states


@pytest.mark.parametrize("solver", ["daqp", pytest.param("clarabel", marks=pytest.mark.wide)])
def test_ticks_in_which_a_tension_meets_a_bound_come_out_again(
    tonus_run: Player, solver: str
) -> None:
    """Pushed so hard that some cables are at their lower bound; from every keyframe on."""
    push = {"kind": "load", "at": 2.5, "force": (200.0, 0.0, 0.0), "rise": 0.3, "duration": 0.6}
    run = tonus_run(
        "hold",
        faults=[push],
        overrides={"control.distribution.solver": solver, "recording.keyframe_s": 0.25},
        duration=0.8,
    )
    log = run.log
    bounded = log["/tonus/tension"]["solver"] == Solver.OPTIMAL
    ticks = log["/tonus/keyframe"]["tick"].astype(int)
    within = [tick for tick in ticks if bounded[tick - 20 : tick + 20].all()]
    assert len(within) > 1
    for tick in ticks:
        found = replay(log, first=int(tick) + 1, last=int(tick) + 100)
        assert found.first is None, found.first
    assert not (log["/tonus/tension"]["solver"] == Solver.FALLBACK).any()


def test_the_whole_of_a_run_over_can_comes_out_again(sine: Log) -> None:
    found = replay(sine)
    assert found.first is None, found.first
    assert not found.unchecked


def test_missing_records_are_bridged_by_the_next_keyframe_and_told(
    sine: Log, tmp_path: Path
) -> None:
    def lose(_topic: str, _rows: np.ndarray, sequence: np.ndarray) -> np.ndarray:
        return (sequence < 1000) | (sequence >= 1100)

    found = replay(open_log(altered(sine.path, tmp_path / "gap.mcap", lose)))
    assert found.first is None, found.first
    (keyframe,) = found.keyframes
    ticks = sine["/tonus/timing"]["tick"]
    assert found.unchecked == [(ticks[1100], keyframe)]


@settings(
    max_examples=12,
    derandomize=True,
    deadline=None,
    phases=[Phase.generate],
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    tick=st.integers(0, FIRST - 1),
    signal=st.sampled_from([(topic, name) for topic in INPUTS for name in INPUTS[topic]]),
    where=st.integers(0, 10_000),
)
def test_one_bit_of_one_input_is_found_in_its_tick(
    beginning: Path, tmp_path: Path, tick: int, signal: tuple[str, str], where: int
) -> None:
    topic, name = signal

    def flip(at: str, rows: np.ndarray, sequence: np.ndarray) -> np.ndarray:
        if at == topic:
            value = rows[name][sequence == tick].copy()
            bits = value.reshape(-1).view(np.uint8)
            if len(bits):
                bits[where // 8 % len(bits)] ^= 1 << where % 8
            rows[name][sequence == tick] = value
        return np.ones(len(rows), bool)

    log = open_log(altered(beginning, tmp_path / "bit.mcap", flip))
    first = replay(log).first
    assert first is not None
    assert first.tick == log["/tonus/timing"]["tick"][tick]
    assert first.field == "inputs"


def test_a_command_that_nobody_gave_is_found(beginning: Path, tmp_path: Path) -> None:
    def command(number: int) -> Path:
        def give(topic: str, rows: np.ndarray, sequence: np.ndarray) -> np.ndarray:
            if topic == "/tonus/state":
                rows["operator"][sequence == 70] = number
            return np.ones(len(rows), bool)

        return altered(beginning, tmp_path / f"{number}.mcap", give)

    tick = int(open_log(beginning)["/tonus/timing"]["tick"][70])
    first = replay(open_log(command(Operator.HOLD))).first
    assert first is not None
    assert (first.tick, first.field) == (tick, "inputs")
    with pytest.raises(ToolError, match=f"tick {tick} has operator command 77"):
        replay(open_log(command(77)))


def test_ticks_that_go_back_are_refused(beginning: Path, tmp_path: Path) -> None:
    def turn_back(topic: str, rows: np.ndarray, sequence: np.ndarray) -> np.ndarray:
        if topic == "/tonus/timing":
            rows["tick"][sequence == 70] = 3
        return np.ones(len(rows), bool)

    with pytest.raises(ToolError, match="tick 3 comes after tick"):
        replay(open_log(altered(beginning, tmp_path / "back.mcap", turn_back)))


def test_segments_are_replayed_as_one_run(sine: Log, tmp_path: Path) -> None:
    parts = [
        altered(sine.path, tmp_path / "1.mcap", lambda _topic, _rows, number: number < 1500),
        altered(sine.path, tmp_path / "2.mcap", lambda _topic, _rows, number: number >= 1500),
    ]
    found = replay(open_log(parts), last=2500)
    assert found.first is None, found.first
    assert not found.unchecked
    assert not found.keyframes


def test_one_gain_is_enough_to_differ_and_the_place_is_named(sine: Log, tmp_path: Path) -> None:
    config = yaml.safe_load(sine.config_text or "")
    config["control"]["tension_loop"]["proportional"] *= 1.0 + 1e-12
    changed = altered(
        sine.path,
        tmp_path / "gain.mcap",
        attachments={"config.yaml": yaml.safe_dump(config).encode()},
    )
    for begin in (0, 2000):
        found = replay(open_log(changed), first=begin, last=begin + 900)
        assert found.first is not None
        assert found.first.field == "torque_command"
        assert found.first.recorded != found.first.replayed


def test_the_command_tells_the_difference_in_every_digit(sine: Log, tmp_path: Path) -> None:
    config = yaml.safe_load(sine.config_text or "")
    config["control"]["stiffness"]["base"] *= 1.0 + 1e-12
    changed = altered(
        sine.path, tmp_path / "k.mcap", attachments={"config.yaml": yaml.safe_dump(config).encode()}
    )
    told = CliRunner().invoke(log_command, ["replay", str(changed), "--to", "2000"])
    assert told.exit_code == 1
    assert "not equal, first in tick" in told.output
    assert "0x1." in told.output


def test_what_another_configuration_would_have_commanded(sine: Log) -> None:
    told = CliRunner().invoke(
        log_command, ["replay", str(sine.path), "--with", "config/direct.yaml"]
    )
    assert told.exit_code == 0, told.output
    same = len(sine["/tonus/timing"])
    assert f"in the recorded state in {same} of {same} ticks" in told.output
    assert "apart 0, most 0" in told.output, "the same controller on another bus"
