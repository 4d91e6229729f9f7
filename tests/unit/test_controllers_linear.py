"""What each controller says that its feedback comes to is what it does; who does not say it has no
margins."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tonus.config import load
from tonus.runtime.control.controllers import CONTROLLERS, Motion
from tonus.runtime.control.controllers.base import LEVEL, Controller
from tonus.runtime.control.controllers.bio import Bio
from tonus.runtime.control.controllers.cable_length import PidLength
from tonus.runtime.control.controllers.linear import NoLinearLawError
from tonus.tools.check.rules import check
from tonus.tools.margins.task import margins

CONFIG, SCENARIO = load("config/can.yaml")
CABLES = CONFIG.robot.cables
HOME, PERIOD = np.array(CONFIG.robot.home), CONFIG.control.rates.period
SMALL, ALONG = 1e-5, np.array([1.0, 0.0, 0.0])
SPRINGS = [name for name in CONTROLLERS if name != "pid_length"]


def motion(**changes: Any) -> Motion:
    still: dict[str, Any] = {
        "desired_position": HOME,
        "position": HOME,
        "quaternion": LEVEL,
        "contact": 0.0,
        "wound": np.ones(CABLES),
        "winding": np.zeros(CABLES),
    }
    names = ("desired_velocity", "desired_acceleration", "velocity", "angular_velocity")
    for name in (*names, "external", "shortfall", "push"):
        still[name] = np.zeros(3)
    return Motion(**(still | changes))


def made(name: str) -> Controller:
    return CONTROLLERS[name](CONFIG.robot, CONFIG.control)


def push(name: str, stiffness: float, **changes: Any) -> float:
    """N along x, in the first tick."""
    return float(made(name).wrench(motion(**changes), stiffness)[0])


@pytest.mark.parametrize("name", SPRINGS)
def test_stiffness_and_damping_are_those_stated(name: str) -> None:
    for law in made(name).stated_laws():
        if law.body:
            continue
        rest = push(name, law.stiffness)
        off = push(name, law.stiffness, position=HOME + SMALL * ALONG)
        moving = push(name, law.stiffness, velocity=SMALL * ALONG)
        # The integral has had one tick of the error.
        stated = law.stiffness + PERIOD * law.integral
        assert (rest - off) / SMALL == pytest.approx(stated, rel=1e-6)
        assert (rest - moving) / SMALL == pytest.approx(law.damping, rel=1e-6)


@pytest.mark.parametrize("name", SPRINGS)
def test_an_integral_grows_as_stated(name: str) -> None:
    law, controller = made(name).stated_laws()[0], made(name)
    off = motion(position=HOME - SMALL * ALONG)
    first, second = (float(controller.wrench(off, law.stiffness)[0]) for _ in range(2))
    assert (second - first) / SMALL / PERIOD == pytest.approx(law.integral, rel=1e-5, abs=1e-3)


@pytest.mark.parametrize("name", ["force", "bio_observer"])
def test_the_feedback_of_contact_is_the_one_stated(name: str) -> None:
    law, asked = made(name).stated_laws()[-1], 10.0
    assert law.body == CONFIG.control.force.body_stiffness
    stiffness = made(name).resting_stiffness
    proportional, integral = law.contact
    for force in (9.0, 8.0):
        controller = made(name)
        touching = motion(push=asked * ALONG, contact=force)
        there = motion(push=asked * ALONG, contact=asked)
        met = float(made(name).wrench(there, stiffness)[0])
        first, second = (float(controller.wrench(touching, stiffness)[0]) for _ in range(2))
        missing = asked - force
        assert first - met == pytest.approx((proportional + PERIOD * integral) * missing)
        assert second - first == pytest.approx(PERIOD * integral * missing)


def test_the_feedback_of_the_drums_is_the_one_stated() -> None:
    (law,) = made("pid_length").stated_laws()
    proportional, derivative, integral = law.cable
    centre = np.full(CABLES, CONFIG.control.tension.pre)
    stiffness = made("pid_length").resting_stiffness

    def tension(**changes: Any) -> Any:
        return made("pid_length").tensions(motion(**changes), stiffness, centre)

    rest = tension()
    assert rest is not None
    longer = (tension(wound=np.ones(CABLES) + SMALL) - rest) / SMALL
    np.testing.assert_allclose(longer, proportional + PERIOD * integral, rtol=1e-5)
    winding = (tension(winding=np.full(CABLES, SMALL)) - rest) / SMALL
    np.testing.assert_allclose(winding, -derivative, rtol=1e-5)


class Stiffer(Bio):
    def force(self, motion: Motion, stiffness: float) -> Any:
        return 10.0 * super().force(motion, stiffness)


class Renamed(Bio):
    """Has the feedback of `bio`, and its margins."""


class Saying(Stiffer):
    def linear_laws(self) -> Any:
        return tuple(self._spring(10.0 * law.stiffness) for law in super().linear_laws())


def verdict(monkeypatch: pytest.MonkeyPatch, kind: type[Controller]) -> list[Any]:
    monkeypatch.setitem(CONTROLLERS, "mine", kind)
    control = CONFIG.control.model_copy(update={"controller": "mine"})
    config = CONFIG.model_copy(update={"control": control})
    return [each for each in check(config, SCENARIO) if each.rule == "margins"]


class StifferDrums(PidLength):
    def tensions(self, motion: Motion, stiffness: float, centre: Any) -> Any:
        return 2.0 * super().tensions(motion, stiffness, centre)


def test_a_controller_that_does_not_state_its_feedback_is_linearised(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = verdict(monkeypatch, Stiffer)
    assert [each.ok for each in found] == [False, False]
    assert "linearised from its own output" in found[0].text
    assert margins(CONFIG, "mine") != margins(CONFIG, "bio")
    with pytest.raises(NoLinearLawError, match="Stiffer"):
        made("mine").stated_laws()


def test_a_controller_that_commands_tensions_has_to_state_its_feedback(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (found,) = verdict(monkeypatch, StifferDrums)
    assert not found.ok
    assert "cannot be computed: StifferDrums does not state its linear_laws" in found.text
    with pytest.raises(NoLinearLawError, match="StifferDrums"):
        margins(CONFIG, "mine")


def test_a_controller_has_its_own_margins(monkeypatch: pytest.MonkeyPatch) -> None:
    assert all(each.ok for each in verdict(monkeypatch, Renamed))
    own, shipped = margins(CONFIG, "mine"), margins(CONFIG, "bio")
    assert own.gain_db == pytest.approx(shipped.gain_db)
    assert own.phase_deg == pytest.approx(shipped.phase_deg)
    found = verdict(monkeypatch, Saying)
    assert not any(each.ok for each in found)
    assert margins(CONFIG, "mine") != margins(CONFIG, "bio")
