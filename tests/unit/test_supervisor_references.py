"""The judge: how far references may go, and torques from them (SUP-5); how fast a stop along the
path may be (SUP-8); and a drive in quick stop of a cable that is in use (SUP-12)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.unit.supervisor_setup import STRICT, N, at, claim, judged, seen
from tonus.config import Config, load
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.states import State, StopMode
from tonus.runtime.supervisor.judge import Violation
from tonus.runtime.supervisor.record import CONTROLLED

ON_PATH = (State.SAFE_STOP, StopMode.ON_PATH)
STIFF = [(State.HOLD, StopMode.NONE), (State.ACTIVE, StopMode.NONE)]
SOFT = [(State.REFERENCING, StopMode.NONE), (State.PRETENSION, StopMode.NONE)]
OTHER_STOPS = [(State.SAFE_STOP, StopMode.DESCENT), (State.SAFE_STOP, StopMode.PASSIVE)]
NONE = np.zeros(N, bool)
THIRD = at(3, 1.0) > 0.0


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/can.yaml", overrides=STRICT)[0]


def found(config: Config, for_ms: float, said: dict[str, Any], **given: Any) -> Violation | None:
    """The verdict at the end of a condition that lasts, after a record that was controlled."""
    state = said.get("state", State.ACTIVE)
    controlled = state if state in CONTROLLED else State.ACTIVE
    before = seen(98.0, claim(at_ms=98.0, state=controlled))
    looks = [seen(now, claim(at_ms=now, **said), **given) for now in (100.0, 100.0 + for_ms)]
    return judged(config, before, *looks)[-1]


@pytest.mark.parametrize(("state", "mode"), [*STIFF, *SOFT, ON_PATH, *OTHER_STOPS])
@pytest.mark.parametrize("given_up", [False, True])
@pytest.mark.parametrize("reference", [-0.1, 0.0, 18.4, 18.5, 220.0, 220.1, -np.inf, np.nan])
def test_how_large_a_reference_may_be(
    config: Config, state: State, mode: StopMode, given_up: bool, reference: float
) -> None:
    """From 0 to a tenth beyond T_max wherever tensions follow it, also of a cable that is given up,
    which is none in control; less than T_min is wrong in HOLD and ACTIVE alone."""
    given_up &= state is State.SAFE_STOP
    said = {
        "reference": at(3, reference, 45.0),
        "tension": at(3, 45.0, 45.0),
        "failed": THIRD & given_up,
        "state": state,
        "stop_mode": mode,
    }
    verdict = found(config, 5.0, said)
    above = not reference <= 220.0
    least = 20.25 / 1.1 if (state, mode) in STIFF else 0.0
    below = reference < least
    judges = (state, mode) not in OTHER_STOPS
    assert (verdict is not None) is (judges and (above or below))
    assert verdict is None or (verdict.requirement, verdict.where) == (Requirement.OPPOSED, 3)
    assert verdict is None or found(config, 4.9, said) is None
    off = found(config, 5.0, said, enabled=~THIRD)
    assert off is None or off.requirement is not Requirement.OPPOSED, "it acts on nothing"


@pytest.mark.parametrize(("state", "mode"), [*STIFF, ON_PATH, *SOFT, *OTHER_STOPS])
@pytest.mark.parametrize(
    ("error", "excess", "wrong"),
    [
        (10.0, 300.1, True),
        (10.0, 300.0, False),
        (-10.0, -300.1, True),
        (-10.0, -300.0, False),
        (0.0, 300.1, True),
        (0.0, -300.1, True),
        (2.0, -300.1, True),
        (-2.0, 300.1, True),
    ],
)
def test_a_torque_far_beyond_its_reference(
    config: Config, state: State, mode: StopMode, error: float, excess: float, wrong: bool
) -> None:
    """On the side of the reference, or where the tension has reached it. On the other side it is
    judged by how far it is from the tension."""
    said = {"reference": at(3, 45.0 + error, 45.0), "state": state, "stop_mode": mode}
    given = {"torque": at(3, 45.0 + error + excess, 45.0)}
    judges = (state, mode) in (*STIFF, *SOFT, ON_PATH)
    longest_ms = 20.0 if (state, mode) == ON_PATH else 5.0
    verdict = found(config, longest_ms, said, **given)
    assert (verdict is not None) is (judges and wrong)
    assert verdict is None or (verdict.requirement, verdict.where) == (Requirement.OPPOSED, 3)
    assert found(config, longest_ms - 0.1, said, **given) is None


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize(("torque", "wrong"), [(345.1, True), (345.0, False)])
def test_a_torque_far_beyond_its_reference_in_one_tick_of_two(
    config: Config, which: int, torque: float, wrong: bool
) -> None:
    """A look sees the newest of two in every second tick."""
    torques = np.full((2, N), 45.0)
    torques[which, 3] = torque if which else 90.0 - torque
    said = {"reference": np.full(N, 45.0), "state": State.ACTIVE}
    verdict = found(config, 5.0, said, torques=torques)
    assert (verdict is not None) is wrong
    assert verdict is None or (verdict.requirement, verdict.where) == (Requirement.OPPOSED, 3)


@pytest.mark.parametrize("error", [-2.1, 2.1])
@pytest.mark.parametrize(("pull", "wrong"), [(60.1, True), (60.0, False)])
def test_a_torque_against_its_reference_in_one_tick_of_two(
    config: Config, error: float, pull: float, wrong: bool
) -> None:
    """Whichever of them a look sees; the other one, and the newest, take the tension nowhere."""
    torques = np.full((2, N), 45.0)
    torques[int(error < 0.0), 3] = 45.0 - np.copysign(pull, error)
    said = {"reference": at(3, 45.0 + error, 45.0), "state": State.ACTIVE}
    verdict = found(config, 5.0, said, torques=torques)
    assert (verdict is not None) is wrong
    assert verdict is None or (verdict.requirement, verdict.where) == (Requirement.OPPOSED, 3)
    assert found(config, 4.9, said, torques=torques) is None
    assert found(config, 5.0, said, torques=torques, enabled=~THIRD) is None


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(("momentum", "wrong"), [(0.7, True), (0.9, False), (-0.9, True)])
def test_a_torque_of_a_hundred_newton_that_brakes_its_drum(
    config: Config, sign: float, momentum: float, wrong: bool
) -> None:
    """It turns the way that its tension has to go, and 45 N would stop it in 20 ms; 35 N leave more
    than the 60 that are wrong."""
    said = {"reference": at(3, 45.0 + 10.0 * sign, 45.0), "state": State.ACTIVE}
    given = {"torque": at(3, 45.0 - 100.0 * sign, 45.0), "momentum": at(3, momentum * sign)}
    verdict = found(config, 5.0, said, **given)
    assert (verdict is not None) is wrong
    assert verdict is None or (verdict.requirement, verdict.where) == (Requirement.OPPOSED, 3)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("step", "wrong"),
    [(0.0, True), (0.1, True), (0.9, True), (1.0, False), (1.1, False), (-1.1, True)],
)
def test_a_tension_that_is_soon_at_its_reference(
    config: Config, sign: float, step: float, wrong: bool
) -> None:
    """A torque of 40 N takes it away from there, and it is 10 N off. Each look it is so many N
    nearer; in the 20 ms that the torque may last it gets there, or not."""
    looks = []
    for look in range(12):
        at_ms = 100.0 + 2.0 * look
        tension = at(3, 45.0 + sign * step * look, 45.0)
        reference = at(3, tension[3] + sign * 10.0, 45.0)
        said = claim(at_ms=at_ms, tension=tension, reference=reference)
        torque = at(3, tension[3] - sign * 40.0, 45.0)
        looks.append(seen(at_ms, said, tension=tension, torque=torque))
    verdict = judged(config, *looks)[-1]
    assert (verdict is not None) is wrong
    assert verdict is None or (verdict.requirement, verdict.where) == (Requirement.OPPOSED, 3)


def test_a_torque_beyond_its_reference_that_follows_a_thrown_platform(config: Config) -> None:
    """The tension rises to its reference by itself, and the drum has to pay out: its torque is as
    far from the reference as none on the other side may be."""
    looks = []
    for look in range(6):
        at_ms = 100.0 + 2.0 * look
        tension = at(3, 80.0 + 0.6 * look, 45.0)
        said = claim(at_ms=at_ms, tension=tension, reference=at(3, tension[3] + 10.0, 45.0))
        torque = at(3, -320.0, 45.0)
        looks.append(seen(at_ms, said, tension=tension, torque=torque))
    assert judged(config, *looks) == [None] * 6


def test_a_torque_that_is_driven_away_by_a_thrown_platform(config: Config) -> None:
    """It is away from a tension that goes against it: what follows the platform."""
    for tension, torque in ((60.0, 380.0), (30.0, -320.0)):
        looks = []
        for look in range(4):
            step = 0.1 * look if torque > tension else -0.1 * look
            pulled = at(3, tension - step, 45.0)
            said = claim(at_ms=100.0 + 2 * look, tension=pulled)
            given = {"tension": pulled, "torque": at(3, torque, 45.0)}
            looks.append(seen(100.0 + 2 * look, said, **given))
        assert judged(config, *looks[1:]) == [None] * 3


def test_a_drive_without_power_may_have_been_sent_any_torque(config: Config) -> None:
    """What it is sent acts on nothing."""
    said = {"reference": np.full(N, 45.0), "state": State.ACTIVE}
    given = {"torque": at(3, 400.0, 45.0), "enabled": ~THIRD, "mille": at(3, 0, 100)}
    assert found(config, 5.0, said, **given) is None


@pytest.mark.parametrize(
    ("speed", "for_ms", "found_in"),
    [
        (1.4, 20.0, (StopMode.ON_PATH, StopMode.DESCENT, StopMode.NONE)),
        (1.4, 19.9, (StopMode.DESCENT, StopMode.NONE)),
        (1.4, 5.0, (StopMode.DESCENT, StopMode.NONE)),
        (1.4, 4.9, ()),
        (3.5, 110.0, tuple(StopMode)),
        (3.5, 109.9, (StopMode.ON_PATH, StopMode.DESCENT, StopMode.NONE)),
        (0.79, 20.0, (StopMode.ON_PATH,)),
        (0.49, 60.0, ()),
    ],
)
@pytest.mark.parametrize("mode", StopMode)
def test_how_fast_a_stop_may_be(
    config: Config, mode: StopMode, speed: float, for_ms: float, found_in: tuple[StopMode, ...]
) -> None:
    """Along the path, and in a descent, or one of no known kind; a passive one sinks."""
    geometry = config.robot.geometry
    along = np.array(geometry.frame) - np.array(geometry.platform)
    rates = along @ np.array([0.0, 0.0, speed]) / np.linalg.norm(along, axis=1)
    said = {"state": State.SAFE_STOP, "stop_mode": mode}
    # A passive stop's torques brake its drums.
    torque = np.maximum(-120.0 * rates, 0.0)
    verdict = found(config, for_ms, said, rate=rates, torque=torque)
    assert (verdict is not None) is (mode in found_in)
    assert verdict is None or verdict.requirement is Requirement.SPEED


@pytest.mark.parametrize("state", [State.OFF, State.STANDBY, State.FAULT])
@pytest.mark.parametrize("mode", [StopMode.NONE, StopMode.DESCENT])
def test_a_disarmed_robot_has_the_wide_bounds(config: Config, state: State, mode: StopMode) -> None:
    """For as long as its drives may take to switch off."""
    geometry = config.robot.geometry
    along = np.array(geometry.frame) - np.array(geometry.platform)
    rates = along @ np.array([0.0, 0.0, 1.4]) / np.linalg.norm(along, axis=1)
    said = {"state": state, "stop_mode": mode}
    assert found(config, 49.0, said, rate=rates) is None
    assert found(config, 49.0, said, tension=at(3, 261.0, 45.0)) is None


def test_how_fast_a_descent_may_turn(config: Config) -> None:
    """As fast as a torn cable lets it, for 40 ms."""
    geometry = config.robot.geometry
    frame, platform = np.array(geometry.frame), np.array(geometry.platform)
    along = (frame - platform) / np.linalg.norm(frame - platform, axis=1, keepdims=True)
    about = np.cross(platform, along) @ np.array([0.0, 0.0, 1.0])
    for mode, rate, for_ms, wrong in (
        (StopMode.ON_PATH, 4.0, 20.0, True),
        (StopMode.DESCENT, 4.9, 100.0, False),
        (StopMode.DESCENT, 5.1, 39.0, False),
        (StopMode.DESCENT, 5.1, 40.0, True),
    ):
        said = {"state": State.SAFE_STOP, "stop_mode": mode}
        assert (found(config, for_ms, said, rate=rate * about) is not None) is wrong


@pytest.mark.parametrize(("state", "mode"), [*STIFF, *SOFT, ON_PATH, *OTHER_STOPS])
@pytest.mark.parametrize("given_up", [False, True])
def test_a_drive_that_holds_its_motor_by_itself(
    config: Config, state: State, mode: StopMode, given_up: bool
) -> None:
    """In quick stop it has power, and takes no torque."""
    given_up &= state is State.SAFE_STOP
    said = {"state": state, "stop_mode": mode, "failed": THIRD & given_up}
    verdict = found(config, 20.0, said, useless=THIRD)
    judges = (state, mode) in (*STIFF, (State.PRETENSION, StopMode.NONE), ON_PATH)
    assert (verdict is not None) is (judges and not given_up)
    assert verdict is None or (verdict.requirement, verdict.where) == (Requirement.DISARMED, 3)
    assert found(config, 19.9, said, useless=THIRD) is None
