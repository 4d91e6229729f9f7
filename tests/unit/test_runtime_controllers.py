"""What each controller asks for, worked out by hand; and the odd ones closed on the plant."""

from __future__ import annotations

import math
from typing import Any, get_args

import numpy as np
import pytest
from loop import QUICK, ClosedLoop, configured, contact_of, rms
from numpy.typing import NDArray

from tonus.config import ConfigError, load
from tonus.config.schema.controller import ControllerName
from tonus.config.schema.scenario import Scenario
from tonus.runtime.control.controllers import CONTROLLERS, Controller, Motion
from tonus.runtime.control.controllers.pid import PidAtRest
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.control.passivity import damping
from tonus.runtime.states import Fault, State

CONFIG, _ = load("config/can.yaml")
ROBOT, CONTROL = CONFIG.robot, CONFIG.control
LAW, PERIOD, MASS = CONTROL.stiffness, CONTROL.rates.period, ROBOT.platform.mass
WEIGHT = MASS * ROBOT.gravity
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
X = np.array([1.0, 0.0, 0.0])
Array = NDArray[np.float64]


def lengths_at(position: Array) -> Kinematics:
    kinematics = Kinematics(ROBOT.geometry)
    kinematics.evaluate(position, LEVEL)
    return kinematics


def motion(**changes: Any) -> Motion:
    """At rest where it should be, with nothing pushing."""
    still: dict[str, Any] = {
        "desired_position": np.zeros(3),
        "desired_velocity": np.zeros(3),
        "desired_acceleration": np.zeros(3),
        "position": np.zeros(3),
        "quaternion": LEVEL,
        "velocity": np.zeros(3),
        "angular_velocity": np.zeros(3),
        "external": np.zeros(3),
        "contact": 0.0,
        "shortfall": np.zeros(3),
        "wound": lengths_at(np.zeros(3)).lengths,
        "winding": np.zeros(8),
        "push": np.zeros(3),
    }
    return Motion(**(still | changes))


def controller(name: str, **overrides: Any) -> Controller:
    changes = {f"control.{name}.{key}": value for key, value in overrides.items()}
    config, _ = load("config/can.yaml", overrides=changes)
    return CONTROLLERS[name](config.robot, config.control)


def asked(found: Controller, now: Motion, ticks: int = 1) -> tuple[float, Array]:
    for _ in range(ticks):
        stiffness = found.stiffness(now)
        wrench = found.wrench(now, stiffness)
    return stiffness, wrench


def test_the_configuration_knows_the_controllers_there_are() -> None:
    assert set(get_args(ControllerName)) == set(CONTROLLERS)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_at_rest_in_its_place_every_controller_asks_for_the_weight_alone(name: str) -> None:
    stiffness, wrench = asked(controller(name), motion())
    assert LAW.minimum < stiffness <= LAW.maximum
    np.testing.assert_allclose(wrench, [0.0, 0.0, WEIGHT, 0.0, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("name", ["bio", "pd", "pd_matched", "pid"])
def test_error_rate_acceleration_and_push_each_add_their_force(name: str) -> None:
    found = controller(name, **({"integral": {"gain": 0.0, "limit": 1.0}} if name == "pid" else {}))
    stiffness, wrench = asked(found, motion(desired_position=0.01 * X))
    assert wrench[0] == pytest.approx(0.01 * stiffness)
    stiffness, wrench = asked(found, motion(desired_velocity=0.02 * X))
    assert wrench[0] == pytest.approx(0.02 * damping(found.damping_ratio, stiffness, MASS))
    assert asked(found, motion(desired_acceleration=2.0 * X))[1][0] == pytest.approx(2.0 * MASS)
    assert asked(found, motion(push=7.0 * X))[1][0] == pytest.approx(7.0)


def test_the_law_reads_smoothed_values_and_reaches_63_per_cent_in_its_time_constant() -> None:
    found, loaded = controller("bio"), motion(external=25.0 * X)
    rise = LAW.force_gain * LAW.base
    ticks = round(1.0 / (2.0 * math.pi * LAW.smoothing_hz) / PERIOD)
    after, _ = asked(found, loaded, ticks)
    assert (after - LAW.base) / rise == pytest.approx(1.0 - math.exp(-1.0), abs=0.01)
    assert asked(found, loaded, 200)[0] == pytest.approx(LAW.base + rise, rel=1e-3)
    found.reset()
    assert found.stiffness(motion()) == LAW.base


def test_pid_at_rest_is_pid_with_the_tone_of_bio_observer() -> None:
    pid, at_rest = controller("pid"), PidAtRest(ROBOT, CONTROL)
    assert at_rest.tone == CONTROL.bio_observer.tone < pid.tone == 1.0
    pushed = motion(desired_position=0.01 * X, external=25.0 * X)
    for one, other in zip(asked(pid, pushed, 50), asked(at_rest, pushed, 50), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", ["pid", "bio_integral"])
def test_the_integral_grows_with_the_error_and_does_not_wind_up(name: str) -> None:
    settings = CONTROL.pid.integral if name == "pid" else CONTROL.bio_integral
    found, off = controller(name), motion(desired_position=0.01 * X)
    stiffness = asked(found, off, 100)[0]
    grown = found.wrench(motion(), stiffness)[0]
    assert grown == pytest.approx(100 * PERIOD * settings.gain * 0.01)
    for _ in range(5000):
        found.wrench(off, LAW.minimum)
    held = found.wrench(motion(), stiffness)[0]
    assert held == pytest.approx(grown), "it stands still while something caps the stiffness"
    starved = motion(desired_position=0.01 * X, shortfall=0.01 * stiffness * X)
    for _ in range(5000):
        found.wrench(starved, stiffness)
    assert found.wrench(motion(), stiffness)[0] == pytest.approx(held), "nor against full cables"
    for _ in range(5000):
        found.wrench(off, stiffness)
    assert found.wrench(motion(), stiffness)[0] == pytest.approx(settings.limit)
    found.reset()
    assert found.wrench(motion(), stiffness)[0] == pytest.approx(0.0, abs=1e-9)


def test_the_observer_takes_up_a_load_but_no_contact() -> None:
    found, ticks = controller("bio_observer"), 2000
    _, wrench = asked(found, motion(external=-30.0 * X), ticks)
    assert wrench[0] == pytest.approx(30.0, rel=1e-3)
    _, wrench = asked(found, motion(external=-30.0 * X, contact=30.0), ticks)
    assert wrench[0] == pytest.approx(0.0, abs=0.05)
    _, wrench = asked(found, motion(external=-500.0 * X), ticks)
    assert wrench[0] == pytest.approx(CONTROL.bio_observer.limit, rel=1e-3)
    soft = found.wrench(motion(external=-500.0 * X), LAW.minimum)
    assert soft[0] == pytest.approx(CONTROL.bio_observer.limit * LAW.minimum / LAW.base, rel=1e-3)


def test_a_cable_that_is_too_long_is_pulled_by_its_own_gain_only() -> None:
    place = np.array([0.05, -0.02, 0.03])
    at, gains = lengths_at(place), CONTROL.pid_length
    found = controller("pid_length", integral=0.0)
    stiffness = found.stiffness(motion())
    still = {"desired_position": place, "position": place}
    centre = np.full(8, 45.0)
    forward = found.tensions(motion(**still, wound=at.lengths), stiffness, centre)
    assert forward is not None
    wound = at.lengths / (1.0 + 45.0 / ROBOT.cable.axial_stiffness)
    base = found.tensions(motion(**still, wound=wound), stiffness, centre)
    assert base is not None
    wound[3] += 1.0e-3
    longer = found.tensions(motion(**still, wound=wound), stiffness, centre)
    assert longer is not None
    np.testing.assert_allclose(longer - base, gains.proportional * 1e-3 * np.eye(8)[3], atol=1e-9)
    half = found.tensions(motion(**still, wound=wound), 0.5 * stiffness, centre)
    assert half is not None
    softer = found.tensions(
        motion(**still, wound=wound - 1e-3 * np.eye(8)[3]), 0.5 * stiffness, centre
    )
    assert softer is not None
    assert (half - softer)[3] == pytest.approx(0.5 * gains.proportional * 1e-3)


def test_its_feed_forward_balances_the_weight_and_the_stretch_is_reckoned_with() -> None:
    at, centre = lengths_at(np.zeros(3)), np.full(8, 45.0)
    found = controller("pid_length", integral=0.0)
    forward = np.full(8, 45.0)
    for _ in range(300):
        wound = at.lengths / (1.0 + forward / ROBOT.cable.axial_stiffness)
        now = found.tensions(motion(wound=wound), found.stiffness(motion()), centre)
        assert now is not None
        forward = now
    np.testing.assert_allclose(at.matrix @ forward, [0, 0, WEIGHT, 0, 0, 0], atol=1e-6)


def test_direct_force_control_forgets_the_place_along_the_force_and_keeps_it_across() -> None:
    gains = CONTROL.force
    found = controller("force", integral=0.0)
    off = np.array([0.01, 0.002, 0.0])
    pressing = motion(desired_position=off, push=10.0 * X, contact=8.0)
    stiffness, wrench = asked(found, pressing)
    assert wrench[0] == pytest.approx(10.0 + gains.proportional * 2.0)
    assert wrench[1] == pytest.approx(0.002 * stiffness)
    let_go = motion(desired_position=off)
    assert abs(found.wrench(let_go, stiffness)[0]) < 0.01 * 0.01 * stiffness, "no jump"
    for _ in range(round(5.0 * gains.release_s / PERIOD)):
        _, wrench = asked(found, let_go)
    assert wrench[0] == pytest.approx(0.01 * stiffness, rel=0.01)


def test_equation_9_is_refused_without_a_lab() -> None:
    with pytest.raises(ConfigError, match="eq9_literal"):
        load("config/can.yaml", overrides={"control.controller": "eq9_literal", "lab": None})


# --- closed on the plant -------------------------------------------------------------------------

BODY = {"model": "kelvin_voigt", "stiffness": 210.0, "damping": 8.0}
PRESS = Scenario.model_validate(
    {
        "name": "press",
        "description": "12 N on the phantom",
        "duration": 9.0,
        "reference": {
            "kind": "press", "direction": [1, 0, 0], "distance": 0.02, "approach": 0.7,
            "fade": 0.7, "force": 12.0, "swing": 4.0, "stiffness": 260.0,
        },
        "lab": {"phantom": BODY | {"point": [0.02, 0, 0], "normal": [-1, 0, 0],
                                   "relaxing_stiffness": 105.0, "relaxation_time": 0.5}},
    }
)  # fmt: skip


def closed(name: str, scenario: Scenario | str) -> ClosedLoop:
    config, script = configured("hold", QUICK | {"control.controller": name})
    if isinstance(scenario, str):
        config, script = configured(scenario, QUICK | {"control.controller": name})
    loop = ClosedLoop(config, script if isinstance(scenario, str) else scenario)
    loop.until(State.ACTIVE)
    return loop


@pytest.mark.wide
def test_direct_force_control_needs_not_know_how_stiff_the_body_is() -> None:
    """The scenario takes the phantom for a quarter stiffer than it is: a position controller is 3 N
    off, a force controller is not."""
    off = {}
    for name in ("force", "pd"):
        loop = closed(name, PRESS)
        loop.run(4.0)
        part = loop.trace.during(State.ACTIVE, after=2.0)
        time = part.cycle["state"]["elapsed"]
        wanted = 12.0 + 4.0 * np.sin(np.pi * (time - 0.7))
        off[name] = rms(contact_of(part) - wanted)
    assert off["force"] < 1.0
    assert off["pd"] > 1.5


def test_cable_length_control_follows_a_sine() -> None:
    loop = closed("pid_length", "sine_x")
    loop.run(2.5)
    part = loop.trace.during(State.ACTIVE)
    error = part.truth["position"] - part.cycle["pose"]["desired_position"]
    assert rms(np.linalg.norm(error, axis=1)) < 0.5e-3
    assert loop.state is State.ACTIVE


def test_equation_9_as_printed_oscillates_until_the_envelope_stops_it() -> None:
    loop = closed("eq9_literal", "sine_x")
    loop.run(0.1)
    loop.until(State.SAFE_STOP, within=6.0)
    assert loop.cycle.sequence.fault is not Fault.NONE
    part = loop.trace.during(State.ACTIVE)
    error = part.cycle["tension"]["reference"] - part.truth["tension"]
    assert np.ptp(error[-300:], axis=0).max() > 10.0
    loop.until(State.FAULT)
