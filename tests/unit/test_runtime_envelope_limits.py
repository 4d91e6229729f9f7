"""The envelope at its limits themselves, and how much it takes back, by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tonus.config import load
from tonus.runtime.safety.envelope import Envelope
from tonus.runtime.signals import Bound, Grade
from tonus.runtime.states import Fault

CONFIG, _ = load(
    "config/can.yaml",
    overrides={
        "control.envelope.contact_limit": 25.0,
        "control.envelope.contact_warning": 0.7,
        "control.envelope.speed_limit": 0.25,
        "control.envelope.speed_warning": 0.8,
        "control.envelope.hysteresis": 0.1,
        "control.envelope.horizon": 0.05,
        "control.envelope.workspace_margin": 0.1,
        "control.envelope.tension_warning": 0.9,
        "control.envelope.over_tension_ticks": 5,
        "control.envelope.release_band": 0.1,
        "control.envelope.release_rate": 2.0,
        "control.envelope.rate_cutoff_hz": 20.0,
    },
)
CONTROL, ROBOT = CONFIG.control, CONFIG.robot
SETTINGS, TENSION, LAW, BOX = CONTROL.envelope, CONTROL.tension, CONTROL.stiffness, ROBOT.workspace
PERIOD, N = CONTROL.rates.period, ROBOT.cables
EVERY = np.ones(N, dtype=bool)
MIDDLE = np.array([sum(each) / 2.0 for each in (BOX.x, BOX.y, BOX.z)])
Array = NDArray[np.float64]


class Robot:
    """At ease but for what a test says, in each tick."""

    def __init__(self, **changes: Any) -> None:
        settings = SETTINGS.model_copy(update=changes)
        self.envelope = Envelope(settings, TENSION, LAW, ROBOT, PERIOD)

    def tick(
        self,
        *,
        tension: Any = TENSION.pre,
        contact: float = 0.0,
        position: Array = MIDDLE,
        velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
        bearing: NDArray[np.bool_] = EVERY,
        times: int = 1,
    ) -> Envelope:
        tensions = np.broadcast_to(np.asarray(tension, float), (N,)).copy()
        for _ in range(times):
            self.envelope(tensions, contact, position, np.array(velocity), bearing)
        return self.envelope


def one(cable: int, value: float, others: float = TENSION.pre) -> Array:
    return np.where(np.arange(N) == cable, value, others)


# --- red -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "beyond", "fault"),
    [
        ({"contact": 25.0}, {"contact": math.nextafter(25.0, 0.0)}, Fault.CONTACT_LIMIT),
        ({"velocity": (0.0, -0.25, 0.0)}, {"velocity": (0.0, 0.2499, 0.0)}, Fault.SPEED_LIMIT),
    ],
)
def test_a_limit_that_is_met_is_red(given: Any, beyond: Any, fault: Fault) -> None:
    envelope = Robot().tick(**given)
    assert (envelope.fault, envelope.where, envelope.grade) == (fault, -1, Grade.RED)
    envelope = Robot().tick(**beyond)
    assert (envelope.fault, envelope.grade) == (Fault.NONE, Grade.AMBER)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", range(2))
def test_each_face_of_the_workspace(axis: int, side: int) -> None:
    faces = (BOX.x, BOX.y, BOX.z)[axis]
    outward = 1.0 if side else -1.0
    for off, fault in ((0.001, Fault.WORKSPACE_LIMIT), (0.0, Fault.NONE), (-0.001, Fault.NONE)):
        position = MIDDLE.copy()
        position[axis] = faces[side] + outward * off
        envelope = Robot().tick(position=position)
        assert envelope.fault is fault
        assert envelope.workspace == pytest.approx(-off)
        assert envelope.bound is Bound.WORKSPACE


def test_what_comes_first_of_several() -> None:
    """Contact, then tension, then speed, then place; the cable is the one that lasted longest."""
    outside = MIDDLE + 10.0
    fast = (1.0, 0.0, 0.0)
    over, under = one(5, TENSION.max + 1.0), one(2, TENSION.slack - 1.0)
    both = np.where(np.arange(N) == 2, TENSION.slack - 1.0, over)
    for given, fault, where in (
        ({"contact": 30.0, "tension": both}, Fault.CONTACT_LIMIT, -1),
        ({"tension": both}, Fault.OVER_TENSION, 5),
        ({"tension": under}, Fault.SLACK_CABLE, 2),
        ({}, Fault.SPEED_LIMIT, -1),
    ):
        envelope = Robot().tick(position=outside, velocity=fast, times=5, **given)
        assert (envelope.fault, envelope.where) == (fault, where)


@pytest.mark.parametrize(("value", "other"), [(TENSION.max, 0.1), (TENSION.slack, -0.1)])
def test_how_long_a_tension_may_be_beyond_its_bound(value: float, other: float) -> None:
    """Four ticks, at the bound for ever; one tick within begins it anew."""
    fault = Fault.OVER_TENSION if other > 0.0 else Fault.SLACK_CABLE
    robot = Robot()
    assert robot.tick(tension=one(3, value), times=50).fault is Fault.NONE
    assert robot.tick(tension=one(3, value + other), times=4).fault is Fault.NONE
    assert robot.tick(tension=one(3, value)).fault is Fault.NONE
    assert robot.tick(tension=one(3, value + other), times=4).fault is Fault.NONE
    envelope = robot.tick(tension=one(3, value + other))
    assert (envelope.fault, envelope.where) == (fault, 3)
    robot.envelope.reset()
    assert robot.tick(tension=one(3, value + other), times=4).fault is Fault.NONE


def test_a_cable_that_bears_nothing() -> None:
    """Its margins do not count, nor that it is slack; too tight it is all the same."""
    idle = np.arange(N) != 4
    envelope = Robot().tick(tension=one(4, 0.0), bearing=idle, times=50)
    assert (envelope.fault, envelope.grade) == (Fault.NONE, Grade.GREEN)
    assert (envelope.tension_high, envelope.tension_low) == (1.0, 1.0)
    envelope = Robot().tick(tension=one(4, TENSION.max + 1.0), bearing=idle, times=5)
    assert (envelope.fault, envelope.where) == (Fault.OVER_TENSION, 4)


def test_margins_of_the_tensions_are_the_least_and_predicted() -> None:
    """A tension that rises by 0.2 N a tick is 10 N more in 50 ms."""
    robot = Robot()
    robot.tick(tension=one(1, 60.0))
    envelope = robot.tick(tension=one(1, 60.2))
    assert envelope.tension_high == pytest.approx((200.0 - 70.2) / (TENSION.max - TENSION.pre))
    assert envelope.tension_low == pytest.approx(1.0)
    envelope = robot.tick(tension=one(1, 60.0))
    assert envelope.tension_high == pytest.approx((200.0 - 50.0) / (TENSION.max - TENSION.pre))
    robot = Robot()
    robot.tick(tension=one(7, 40.0))
    envelope = robot.tick(tension=one(7, 39.9))
    low = (39.9 - 5.0 - TENSION.min) / (TENSION.pre - TENSION.min)
    assert envelope.tension_low == pytest.approx(low)
    assert envelope.tension_high == pytest.approx(1.0)


# --- amber ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "share", "bound"),
    [
        ({"contact": 17.5}, 1.0, Bound.NONE),
        ({"contact": 20.0}, 0.5, Bound.CONTACT),
        ({"contact": 22.5}, 0.0, Bound.CONTACT),
        ({"contact": 24.0}, 0.0, Bound.CONTACT),
        ({"velocity": (0.2, 0.0, 0.0)}, 1.0, Bound.NONE),
        ({"velocity": (0.0, 0.0, 0.2125)}, 0.5, Bound.SPEED),
        ({"velocity": (0.0, 0.225, 0.0)}, 0.0, Bound.SPEED),
        ({"tension": one(3, 200.0 - 0.05 * (200.0 - TENSION.pre))}, 0.5, Bound.TENSION_HIGH),
        (
            {"position": MIDDLE + np.array([BOX.x[1] - MIDDLE[0] - 0.025, 0.0, 0.0])},
            0.25,
            Bound.WORKSPACE,
        ),
    ],
)
def test_how_much_is_left(given: dict[str, Any], share: float, bound: Bound) -> None:
    """The reference slows with it; contact and tension make the platform softer as well."""
    envelope = Robot().tick(**given)
    assert envelope.progress == pytest.approx(share, abs=1e-12)
    soft = bound in (Bound.CONTACT, Bound.TENSION_HIGH)
    cap = LAW.minimum + share * (LAW.maximum - LAW.minimum) if soft else LAW.maximum
    assert envelope.cap == pytest.approx(cap)
    assert envelope.bound is bound
    assert envelope.grade is (Grade.AMBER if bound is not Bound.NONE else Grade.GREEN)


def test_a_tension_has_a_zone_of_its_own() -> None:
    envelope = Robot(tension_warning=0.8).tick(tension=one(3, 200.0 - 0.1 * (200.0 - TENSION.pre)))
    assert (envelope.progress, envelope.bound) == (pytest.approx(0.5), Bound.TENSION_HIGH)


def test_the_least_share_decides() -> None:
    envelope = Robot().tick(contact=20.0, velocity=(0.22, 0.0, 0.0))
    assert envelope.bound is Bound.SPEED
    assert envelope.progress == pytest.approx(0.2)
    assert envelope.cap == LAW.maximum
    envelope = Robot().tick(contact=21.5, velocity=(0.2125, 0.0, 0.0))
    assert envelope.bound is Bound.CONTACT
    assert envelope.progress == pytest.approx(0.2)


def test_of_equal_shares_the_one_that_softens_decides() -> None:
    """Contact comes first: a platform that is both fast and touching is soft."""
    both = Robot().tick(contact=24.0, velocity=(0.24, 0.0, 0.0), times=2)
    assert (both.bound, both.cap, both.progress) == (Bound.CONTACT, LAW.minimum, 0.0)
    tight = Robot().tick(contact=24.0, tension=one(3, TENSION.max + 1.0), times=2)
    assert tight.bound is Bound.CONTACT


def test_no_share_is_more_than_the_whole() -> None:
    """Where about twice as much as the zone of each bound is left."""
    tight = TENSION.max - 0.205 * (TENSION.max - TENSION.pre)
    given = {"contact": 12.25, "velocity": (0.17375, 0.0, 0.0), "tension": tight}
    robot = Robot()
    for _ in range(2):
        envelope = robot.tick(**given)
        assert (envelope.progress, envelope.cap) == (1.0, pytest.approx(LAW.maximum))
        robot.envelope.reset()


def test_tensions_that_fall_too_low_are_amber_but_slow_nothing() -> None:
    span = TENSION.pre - TENSION.min
    for share, grade, bound in (
        (-0.101, Grade.AMBER, Bound.TENSION_LOW),
        (-0.099, Grade.GREEN, Bound.NONE),
    ):
        envelope = Robot().tick(tension=one(2, TENSION.min + share * span))
        assert envelope.tension_low == pytest.approx(share)
        assert (envelope.grade, envelope.bound) == (grade, bound)
        assert (envelope.progress, envelope.cap) == (1.0, LAW.maximum)


def test_without_a_margin_the_workspace_slows_nothing() -> None:
    position = MIDDLE.copy()
    position[2] = BOX.z[1]
    robot = Robot(workspace_margin=0.0)
    envelope = robot.tick(position=position)
    assert (envelope.grade, envelope.progress) == (Grade.GREEN, 1.0)
    position[2] += 0.001
    envelope = robot.tick(position=position)
    assert (envelope.grade, envelope.progress) == (Grade.RED, 1.0), "it stops, and slows nothing"


def test_the_growth_of_a_contact_is_filtered_and_counts_ahead() -> None:
    """By a low pass of the first order, 20 Hz; a force that falls is taken as it is."""
    robot, swell, last = Robot(), 0.0, 1.0
    follow = 1.0 - math.exp(-2.0 * math.pi * 20.0 * PERIOD)
    for contact in (1.0, 1.1, 1.3, 1.6, 1.6, 1.2):
        swell += follow * ((contact - last) / PERIOD - swell)
        last = contact
        force = max(contact, contact + 0.05 * swell)
        envelope = robot.tick(contact=contact)
        assert envelope.contact == pytest.approx((25.0 - force) / 25.0)
    for _ in range(2):
        robot.envelope.reset()
        assert robot.tick(contact=9.0).contact == pytest.approx(16.0 / 25.0), "nothing grows"


def test_a_share_comes_back_slowly_and_a_band_late() -> None:
    """By 2 a second, up to a tenth below what is left, until all is left."""
    robot = Robot()

    def left(share: float, times: int = 1) -> float:
        """Of the speed."""
        speed = 0.225 - 0.025 * share
        return robot.tick(velocity=(speed, 0.0, 0.0), times=times).progress

    assert left(0.5005) == pytest.approx(0.5005)
    assert left(0.8, 300) == pytest.approx(0.7), "and not a tick's worth more"
    assert left(0.5) == pytest.approx(0.5)
    assert left(0.59, 300) == pytest.approx(0.5), "within the band"
    assert [left(0.8) for _ in range(3)] == pytest.approx([0.502, 0.504, 0.506])
    assert left(0.8, 300) == pytest.approx(0.7), "0.8 are left, less the band"
    assert left(0.3) == pytest.approx(0.3), "down it goes at once"
    assert left(9.0, 1000) == 1.0
    assert robot.envelope.bound is Bound.NONE


def test_a_reset_gives_everything_back() -> None:
    robot = Robot()
    robot.tick(contact=22.0, tension=one(0, TENSION.max + 1.0), position=MIDDLE + 10.0, times=9)
    envelope = robot.envelope
    envelope.reset()
    assert (envelope.cap, envelope.progress, envelope.grade) == (LAW.maximum, 1.0, Grade.GREEN)
    assert (envelope.bound, envelope.fault, envelope.where) == (Bound.NONE, Fault.NONE, -1)
    margins = (
        envelope.tension_high,
        envelope.tension_low,
        envelope.contact,
        envelope.speed,
        envelope.workspace,
    )
    assert margins == (1.0,) * 5
    assert robot.tick().progress == 1.0
    assert envelope.grade is Grade.GREEN


def test_speed_and_place_are_shares_and_metres() -> None:
    envelope = Robot().tick(velocity=(0.06, 0.08, 0.0))
    assert envelope.speed == pytest.approx(0.6)
    half = min(BOX.x[1] - BOX.x[0], BOX.y[1] - BOX.y[0], BOX.z[1] - BOX.z[0]) / 2.0
    assert Robot().tick().workspace == pytest.approx(half)
