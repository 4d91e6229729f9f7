"""A robot whose axes differ, in whole runs."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np
import pytest

from tests.loop import QUICK, ClosedLoop
from tests.torn import Torn
from tonus.config import load
from tonus.config.loader import load_bounds
from tonus.runtime.signals import TABLE
from tonus.runtime.states import Fault, State
from tonus.sim.devices.cia402.axis_table import TARGET
from tonus.sim.devices.samples import Samples
from tonus.tools.identify import identify
from tonus.tools.log import Log
from tonus.tools.log.attached import configuration
from tonus.tools.testing.player import Player

pytestmark = [
    pytest.mark.tonus(config="config/direct.yaml", overrides=QUICK),
    pytest.mark.wide,
]

CABLES = 8

BUSES = ("config/direct.yaml", "config/can.yaml", "config/ethercat.yaml")
FLIPPED = (1, 4, 6)
SIGNS = np.array([-1 if axis in FLIPPED else 1 for axis in range(CABLES)])
UNLIKE, _ = load("config/unlike_axes.yaml")
AXES = UNLIKE.robot.model_dump(mode="json")["axes"]
Wire = dict[str, list[Any]]


@pytest.mark.tonus_expect("envelope")
def test_a_robot_that_lists_the_defaults_for_every_axis_is_the_same_robot(
    tonus_run: Player,
) -> None:
    uniform, _ = load("config/direct.yaml")
    robot = uniform.robot.model_dump(mode="json")
    same = {name: robot[name] for name in ("cable", "drum", "gearbox", "motor")} | {"sign": 1}
    logs = []
    for axes in ({}, dict.fromkeys(range(CABLES), same)):
        run = tonus_run("contact", overrides={"robot.axes": axes}, duration=0.5)
        assert run.state == "STANDBY", run.reason
        assert len(configuration(run.log).robot.axes) == len(axes)
        logs.append(run.log)
    for name in (*(topic.name for topic in TABLE), "/tonus/truth"):
        ours, theirs = (log[name] for log in logs)
        assert len(ours) > 1000
        assert ours.tobytes() == theirs.tobytes(), name


@pytest.fixture
def wire(monkeypatch: pytest.MonkeyPatch) -> Wire:
    """What every emulated drive sends and receives, in device units, in the order of time."""
    exchanged: Wire = defaultdict(list)
    sample = Samples.at

    def at(samples: Samples, now_ns: int) -> list[int]:
        words = sample(samples, now_ns)
        exchanged["sent"].append((now_ns, *words[: 2 * CABLES]))
        exchanged["torques"].append(tuple(samples.axes.integers[TARGET]))
        return words

    monkeypatch.setattr(Samples, "at", at)
    return exchanged


@pytest.mark.parametrize(
    "path", [BUSES[0], *(pytest.param(path, marks=pytest.mark.long) for path in BUSES[1:])]
)
def test_motors_that_turn_the_other_way_move_the_platform_alike(
    path: str, wire: Wire, tonus_run: Player
) -> None:
    wires, logs = [], []
    for flipped in ((), FLIPPED):
        wire.clear()
        axes = {"robot.axes": {axis: {"sign": -1} for axis in flipped}}
        run = tonus_run("sine_z", config=path, overrides=axes, duration=1.0)
        assert run.state == "STANDBY", run.reason
        wires.append(dict(wire))
        logs.append(run.log)
    _same_motion(*logs)
    one, other = ({row[0]: row[1:] for row in exchanged["sent"]} for exchanged in wires)
    shared = sorted(one.keys() & other.keys())
    assert len(shared) > 2000
    sent, mirrored = (np.array([each[now] for now in shared]) for each in (one, other))
    turned = sent[:, :CABLES]
    assert (np.ptp(turned, axis=0) > 2000).all(), "every motor turns"
    apart = SIGNS * mirrored[:, :CABLES] - turned
    assert np.abs(apart).max() < 0.01 * np.ptp(turned)
    flowing = sent[:, CABLES : 2 * CABLES]
    assert np.median(flowing, axis=0).min() > 20, "per mille, reeling in"
    assert (np.median(mirrored[:, CABLES : 2 * CABLES], axis=0) * SIGNS > 20).all()
    ours, theirs = (np.array(exchanged["torques"]) for exchanged in wires)
    assert (ours.max(axis=0) > 20).all()
    assert np.mean(SIGNS * theirs, axis=0) == pytest.approx(np.mean(ours, axis=0), rel=0.02)


def _same_motion(one: Log, other: Log) -> None:
    """In truth, and in what control knows and commands: the encoders count down from the other
    edge of an increment, so that the runs differ by what one increment is worth."""
    for name, field, most in (
        ("/tonus/truth", "position", 1e-5),
        ("/tonus/truth", "tension", 0.1),
        ("/tonus/truth", "drum_angle", 1e-3),
        ("/tonus/truth", "current", 0.5),
        ("/tonus/pose", "position", 1e-5),
        ("/tonus/drives", "angle", 1e-3),
    ):
        ours, theirs = (log[name][field][-1000:] for log in (one, other))
        assert np.abs(ours - theirs).max() < most, (name, field, np.abs(ours - theirs).max())


@pytest.mark.parametrize(
    ("scenario", "duration"),
    [pytest.param("load_test", 14.0, marks=pytest.mark.long), ("contact_near", 4.5)],
)
@pytest.mark.tonus_expect("wrench_deficit", "envelope")
def test_other_winches_on_four_axes_play_it_to_its_end_within_bounds(
    scenario: str, duration: float, tonus_run: Player
) -> None:
    run = tonus_run(scenario, config="config/unlike_axes.yaml", duration=duration, seed=4)
    assert run.state == "STANDBY", "isolation finds nothing"
    run.invariants(replayed=True)
    log = run.log
    active = log["/tonus/state"]["state"] == State.ACTIVE
    stiffness = log["/tonus/stiffness"]["k_eq"][active]
    assert active.sum() == round(1000.0 * duration) + 1
    assert (stiffness >= UNLIKE.control.stiffness.minimum).all()
    if scenario == "contact_near":
        limit = UNLIKE.control.envelope.contact_limit
        assert 5.0 < log["/tonus/truth"]["contact_force"].max() < limit


def test_each_kind_of_axis_is_identified_by_itself(tonus_run: Player) -> None:
    run = tonus_run("identify_motion", overrides={"robot.axes": AXES}, duration=10.0)
    found = identify([run.path], truth=True)
    inertia = {each.axes: each for each in found.estimates if each.name == "drum_inertia"}
    assert list(inertia) == [(0, 1, 2, 3), (4, 5, 6), (7,)]
    assert inertia[4, 5, 6].keys == tuple(f"robot.axes.{axis}.drum.inertia" for axis in (4, 5, 6))
    stiffness = {each.axes: each for each in found.estimates if each.name == "axial_stiffness"}
    assert list(stiffness) == [(0, 1, 2, 3, 7), (4, 5, 6)]
    for each in (*inertia.values(), *stiffness.values()):
        assert each.value == pytest.approx(each.truth, rel=0.02), each.text
        assert each.truth == pytest.approx(each.configured), each.text


@pytest.mark.parametrize("path", [BUSES[1], pytest.param(BUSES[2], marks=pytest.mark.long)])
def test_the_drives_of_other_winches_are_set_up_on_a_bus(path: str, tonus_run: Player) -> None:
    """Each against the rated torque of its own motor; a wrong one would be refused."""
    run = tonus_run("sine_z", config=path, overrides={"robot.axes": AXES}, duration=0.6)
    assert run.state == "STANDBY", run.reason
    log = run.log
    part = slice(-500, None)
    wanted = log["/tonus/pose"]["desired_position"]
    error = (log["/tonus/pose"]["position"] - wanted)[log["/tonus/state"]["state"] == State.ACTIVE]
    assert np.abs(error[part]).max() < 1e-3


def test_angles_rates_and_torques_are_each_axis_own() -> None:
    """Control's own numbers against the plant's, which are computed separately."""
    config, scenario = load("config/can.yaml", "sine_z", QUICK | {"robot.axes": AXES})
    loop = ClosedLoop(config, scenario)
    loop.until(State.ACTIVE)
    loop.run(0.5)
    trace = loop.trace.during(State.ACTIVE, after=0.1)
    angle, true = trace.cycle["drives"]["angle"], trace.truth["drum_angle"]
    assert np.ptp(true, axis=0).min() > 0.03
    assert np.abs(angle - true).max() < 3e-3, "an increment and what a drum turns in a tick or two"
    rate = trace.cycle["drives"]["rate"].sum(axis=0) * config.control.rates.period
    assert rate == pytest.approx(true[-1] - true[0], abs=3e-3)
    asked, given = trace.cycle["tension"]["reference"], trace.truth["tension"]
    assert np.abs(asked - given).mean(axis=0).max() < 1.0


@pytest.mark.parametrize(
    "cable", [4, *(pytest.param(axis, marks=pytest.mark.long) for axis in (5, 6)), 7]
)
def test_a_torn_cable_of_another_winch_is_named(robot: Torn, cable: int) -> None:
    bounds = load_bounds()
    (case,) = robot.cases(cable, ("rest",))
    assert case.where == cable, case
    assert Fault[case.fault] is Fault.CABLE_TORN, case
    assert case.given_up == (cable,), case
    assert case.found_after is not None, case
    assert case.found_after <= bounds.found_within["cable_cut"], case
    assert case.peak_speed <= bounds.speed, case
    assert case.peak_tension <= bounds.tension * UNLIKE.control.tension.max, case
    assert case.at_rest, case


@pytest.fixture(scope="module")
def robot() -> Torn:
    return Torn((0.0, 0.0, 0.0), {"robot.axes": AXES})
