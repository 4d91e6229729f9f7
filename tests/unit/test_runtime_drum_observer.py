"""A drum's motion against its torque, by Newton's law and by hand.

Masses, radii and times are powers of two, so that a bound can be met to the last bit.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tonus.config import load
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.safety.drum_observer import DrumObserver

Array = NDArray[np.float64]
CONFIG, _ = load("config/can.yaml")
TICK = 2.0**-10
"""s"""
RADIUS, MASS = np.array([0.5, 0.25, 0.125]), np.array([2.0, 4.0, 16.0])
LIMIT = np.array([32.0, 16.0, 4.0])
"""N m: 64, 64 and 32 N at the cable"""
N = len(RADIUS)
PULL = 32.0
FORCE, SHARE = 16.0, 0.25
BOUND = FORCE + SHARE * PULL
SMOOTHING = 0.25
"""of the observer: a tick over its time"""
BIT = 2.0**-20
UNDER_WAY = 2
"""ticks from a torque to the sample that it has made"""
CERTAIN = 1000
"""ticks: more than any number that is waited for"""


class Drums:
    """Drums at rest, each with the same pull and tension, shown for so many ticks until they are
    observed; a test changes what is shown."""

    def __init__(self, ticks: int = 8, **changes: float) -> None:
        settings = {
            "sample_doubt": 1.0,
            "acceleration": 2.0,
            "torque_s": TICK / SMOOTHING,
            "torque_error": FORCE,
            "torque_share": SHARE,
        }
        robot: Any = SimpleNamespace(
            cables=N, drum_radius=RADIUS, drum_mass=MASS, torque_limit=LIMIT
        )
        self.observer = DrumObserver(
            robot, CONFIG.control.isolation.model_copy(update=settings | changes)
        )
        self.image = ProcessImage(N)
        self.image.axes["age"] = 0
        self.torque, self.following = RADIUS * PULL, np.zeros(N)
        self.angle, self.rate = np.zeros(N), np.zeros(N)
        self.tension, self.interval = np.full(N, PULL), np.full(N, TICK)
        self.usable, self.failed = np.ones(N, dtype=bool), np.zeros(N, dtype=bool)
        self.enabled = self.skipped = False
        self.tick(ticks)
        self.enabled = True

    def tick(self, count: int = 1) -> list[int]:
        """Ticks in which each drum has been misled."""
        sensing: Any = SimpleNamespace(
            usable=self.usable,
            drums=np.array([self.angle, self.rate, self.interval]),
            tension=self.tension,
        )
        for _ in range(count):
            self.observer.step(
                self.image,
                sensing,
                self.failed,
                self.torque,
                self.following,
                skipped=self.skipped,
                enabled=self.enabled,
            )
        misled: list[int] = self.observer.misled.tolist()
        return misled

    @property
    def unobserved(self) -> list[int]:
        counted: list[int] = self.observer.unobserved.tolist()
        return counted

    def push(self, drum: int, force: float) -> list[int]:
        """One tick with so much more tension (N) in one cable; the drum does not move."""
        self.tension[drum] += force
        misled = self.tick()
        self.tension[drum] -= force
        return misled


@pytest.fixture
def drums() -> Drums:
    return Drums()


def only(drum: int, count: int) -> list[int]:
    return [count if each == drum else 0 for each in range(N)]


NONE = [0] * N


# --- momentum ------------------------------------------------------------------------------------


def test_what_is_unexplained_is_newtons_residual_in_a_low_pass() -> None:
    """m a - (pull - tension) by differences of speed, smoothed, against its bound; with torques
    that are two ticks old, and samples of which some are of two ticks."""
    random = np.random.default_rng(7)
    drums, ticks = Drums(acceleration=1e6), 400
    torques = [RADIUS * PULL] * UNDER_WAY
    speed, residual, mean = np.zeros(N), np.zeros(N), np.full(N, PULL)
    misled, some = np.zeros(N, dtype=int), np.zeros(N, dtype=int)
    for _ in range(ticks):
        pull = torques[-UNDER_WAY] / RADIUS
        torques.append(RADIUS * random.normal(0.0, 60.0, N))
        drums.tension = np.abs(random.normal(30.0, 30.0, N))
        drums.interval = TICK * random.integers(1, 3, N)
        left = random.normal(0.0, 80.0, N)
        before = speed
        speed = speed + drums.interval * (pull - drums.tension + left) / MASS
        newton = MASS * (speed - before) / drums.interval - (pull - drums.tension)
        share = SMOOTHING * drums.interval / TICK
        residual = (1.0 - share) * residual + share * newton
        mean = (1.0 - share) * mean + share * np.abs(pull)
        over = np.abs(residual) - (FORCE + SHARE * mean)
        assert (np.abs(over) > 1e-6).all(), "none is at its bound by chance"
        misled = np.where(over > 0.0, misled + 1, 0)
        some += over > 0.0
        drums.torque, drums.rate = torques[-1], speed / RADIUS
        assert drums.tick() == misled.tolist()
        assert drums.observer.most_misled == misled.max()
    assert (some > ticks // 10).all()
    assert (some < ticks - ticks // 10).all()


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("drum", range(N))
@pytest.mark.parametrize("first", [True, False])
def test_the_bound_itself_is_no_fault(drum: int, sign: float, first: bool) -> None:
    """In the first tick that is observed too. One tick takes a quarter of what it finds."""
    drums = Drums()
    assert first or drums.tick() == NONE
    assert drums.push(drum, sign * BOUND / SMOOTHING) == NONE
    drums = Drums()
    assert first or drums.tick() == NONE
    assert drums.push(drum, sign * (BOUND / SMOOTHING + BIT)) == only(drum, 1)
    assert drums.observer.most_misled == 1
    assert drums.tick() == NONE
    assert drums.observer.most_misled == 0


def test_ticks_in_a_row_are_counted(drums: Drums) -> None:
    drums.tension[1] += 2.0 * BOUND
    # A constant force is found to 1 - (3/4)^k of itself: more than half of it from the third on.
    assert [drums.tick()[1] for _ in range(6)] == [0, 0, 1, 2, 3, 4]
    assert drums.observer.misled.tolist() == only(1, 4)
    assert drums.observer.most_misled == 4
    drums.tension[1] -= 2.0 * BOUND
    assert [drums.tick() for _ in range(2)] == [only(1, 5), NONE]


def test_a_torque_makes_its_motion_two_ticks_later(drums: Drums) -> None:
    """Sixteen times the bound is found in the very tick in which it acts."""
    drums.torque = RADIUS * np.array([PULL, PULL + 16.0 * BOUND, PULL])
    assert drums.tick() == NONE
    drums.torque = RADIUS * PULL
    assert drums.tick() == NONE
    assert drums.tick() == only(1, 1)


def test_ticks_are_counted_in_which_an_encoder_shows_no_motion_at_all(drums: Drums) -> None:
    def standing() -> list[int]:
        drums.tick()
        return drums.observer.standing.tolist()

    began = int(drums.observer.standing[0])
    assert standing() == [began + 1] * N
    drums.angle[1] += BIT
    assert standing() == [began + 2, 0, began + 2]
    assert standing() == [began + 3, 1, began + 3]
    drums.angle[1] -= BIT
    drums.failed[2] = True
    assert standing() == [began + 4, 0, 0], "nor of one that is not observed"
    drums.failed[2] = False
    assert standing() == [began + 5, 1, 1]


def test_a_drum_in_motion_is_observed_from_its_momentum_on() -> None:
    """Ten metres a second before it is observed; afterwards nothing that accelerates it."""
    drums = Drums(0)
    drums.enabled = False
    drums.rate = 10.0 / RADIUS
    drums.tick(8)
    drums.enabled = True
    assert [drums.tick() for _ in range(8)] == [NONE] * 8


# --- steps of the speed --------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(("drum", "fastest"), [(0, 64.0), (1, 32.0), (2, 4.0)])
def test_a_drum_speeds_up_by_twice_what_its_motor_can(
    drum: int, fastest: float, sign: float
) -> None:
    """``fastest`` m/s2, twice the strongest pull by the mass. A rate is the mean of its interval:
    between two means of one tick lies a tick, of a tick and three of them two."""
    for since, ticks in ((1.0, 1.0), (3.0, 2.0)):
        for beyond, misled in ((0.0, NONE), (BIT, only(drum, CERTAIN))):
            drums = Drums(torque_error=1e9)
            drums.rate[drum] = 4.0
            for starting in (False, True):
                drums.enabled = not starting
                drums.interval[drum] = since * TICK
                drums.tick()
                drums.enabled = True
                drums.interval[drum] = TICK
                step = fastest * ticks * TICK + beyond
                drums.rate[drum] += sign * step / RADIUS[drum]
                assert drums.tick() == misled
                assert drums.observer.most_misled == max(misled)
                assert drums.tick() == NONE
                step = fastest * TICK
                drums.rate[drum] += sign * step / RADIUS[drum]
                assert drums.tick() == NONE


# --- which drums are observed --------------------------------------------------------------------


def test_nothing_is_counted_before_the_first_tick() -> None:
    drums = Drums(0)
    assert (drums.observer.most_misled, drums.observer.longest_unobserved) == (0, 0)
    assert (drums.unobserved, drums.observer.misled.tolist()) == (NONE, NONE)


HUGE = 1e5
"""N: beyond every bound in one tick"""


@pytest.mark.parametrize("age", [1, 2, 65535])
def test_a_late_sample_and_the_two_after_it_are_not_observed(drums: Drums, age: int) -> None:
    drums.image.axes["age"][1] = age
    assert drums.push(1, HUGE) == NONE
    assert (drums.unobserved, drums.observer.longest_unobserved) == (only(1, 1), 1)
    drums.image.axes["age"][1] = 0
    for count in (2, 3):
        assert drums.push(1, HUGE) == NONE
        assert (drums.unobserved, drums.observer.longest_unobserved) == (only(1, count), count)
    assert drums.push(1, HUGE) == only(1, 1)
    assert (drums.unobserved, drums.observer.longest_unobserved) == (NONE, 0)


def test_a_sample_is_as_certain_as_the_bound_allows(drums: Drums) -> None:
    """Nanoseconds of a bound of a second."""
    drums.image.axes["doubt_ns"] = [10**9, 10**9 + 1, 0]
    drums.tick(2)
    assert (drums.unobserved, drums.observer.longest_unobserved) == (only(1, 2), 2)
    assert drums.push(1, HUGE) == NONE
    assert drums.push(0, HUGE) == only(0, 1)


def test_after_a_missed_tick_all_wait(drums: Drums) -> None:
    drums.skipped = True
    assert drums.push(2, HUGE) == NONE
    drums.skipped = False
    assert drums.push(2, HUGE) == NONE
    assert drums.unobserved == [2] * N
    assert drums.push(2, HUGE) == NONE
    assert drums.push(2, HUGE) == only(2, 1)
    assert drums.unobserved == NONE


@pytest.mark.parametrize("why", ["usable", "failed", "enabled"])
def test_a_drum_that_is_not_to_be_observed_is_neither_misled_nor_unobserved(
    drums: Drums, why: str
) -> None:
    """Its samples go on: it is observed at once when it may be."""
    drums.push(0, HUGE)
    drums.following[0] = 1.0
    for late in (0, 1):
        drums.image.axes["age"] = late
        others = 0 if why == "enabled" else late
        if why == "usable":
            drums.usable[0] = False
        elif why == "failed":
            drums.failed[0] = True
        else:
            drums.enabled = False
        drums.observer.most_misled = -7
        assert drums.push(0, HUGE) == NONE
        assert drums.unobserved == [0, others, others]
        assert drums.observer.longest_unobserved == others
        assert drums.observer.most_misled == 0
        assert drums.observer.travel.tolist() == NONE
    drums.image.axes["age"] = 0
    drums.tick(3)
    drums.usable[0], drums.failed[0], drums.enabled = True, False, True
    assert drums.push(0, HUGE) == only(0, 1)


def show(drums: Drums, rate: float, torque: float, tension: float, following: float) -> list[int]:
    """One tick of the first drum, with this torque behind it."""
    drums.torque[0] = torque
    drums.tick()
    drums.torque[0] = RADIUS[0] * PULL
    drums.tick()
    drums.rate[0], drums.tension[0], drums.following[0] = rate, tension, following
    with np.errstate(all="ignore"):
        misled = drums.tick()
    drums.rate[0], drums.tension[0], drums.following[0] = 0.0, PULL, 0.0
    return misled


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", range(4))
def test_without_a_number_a_drum_is_not_compared_and_then_begins_anew(
    drums: Drums, place: int, bad: float
) -> None:
    usual = (0.0, RADIUS[0] * PULL, PULL, 0.0)
    shown = (bad if each == place else value for each, value in enumerate(usual))
    assert show(drums, *shown) == NONE
    assert drums.observer.travel[0] == 0.0
    assert [drums.tick() for _ in range(2)] == [NONE] * 2
    assert drums.push(0, HUGE) == only(0, 1)


@pytest.mark.parametrize("observed", [True, False])
def test_a_rate_that_was_no_number_before_a_drum_is_observed_says_nothing(
    drums: Drums, observed: bool
) -> None:
    """Of the first sample after a gap there is no rate."""
    drums.usable[0] = observed
    drums.rate[0] = np.nan
    drums.tick()
    drums.usable[0], drums.rate[0] = True, 20.0
    assert [drums.tick() for _ in range(3)] == [NONE] * 3
    assert drums.push(0, HUGE) == only(0, 1)


@pytest.mark.parametrize(
    ("rate", "torque", "tension", "following"),
    [
        (1.6e308, 0.8e308, 0.0, 1.0),
        (0.0, 0.8e308, 1.6e308, 1.0),
        (0.0, 0.0, 1.6e308, 1.6e308),
    ],
)
def test_numbers_without_a_sum_are_not_compared(
    drums: Drums, rate: float, torque: float, tension: float, following: float
) -> None:
    assert show(drums, rate, torque, tension, following) == NONE
    assert drums.observer.travel[0] == 0.0


# --- a drum that stands --------------------------------------------------------------------------


def test_a_standing_drum_should_have_wound_what_the_platform_moves(drums: Drums) -> None:
    drums.following = np.array([1.0, -2.0, 4.0])
    way = TICK * np.array([0.5, -0.5, 0.5])
    drums.tick()
    assert drums.observer.travel.tolist() == way.tolist()
    drums.interval[1] = 2.0 * TICK
    drums.tick(2)
    assert drums.observer.travel.tolist() == (way * [3.0, 5.0, 3.0]).tolist()
    drums.angle[2] = 1e-9
    drums.tick()
    assert drums.observer.travel.tolist() == (way * [4.0, 7.0, 0.0]).tolist()
    drums.tick()
    assert drums.observer.travel.tolist() == (way * [5.0, 9.0, 1.0]).tolist()


def test_it_stands_since_it_was_last_seen(drums: Drums) -> None:
    """An angle from before it could not be observed is none to begin with."""
    drums.usable[0] = False
    drums.angle[0], drums.following[0] = 3.0, 1.0
    drums.tick()
    drums.usable[0] = True
    drums.tick()
    assert drums.observer.travel.tolist() == [0.5 * TICK, 0.0, 0.0]


# --- a new beginning -----------------------------------------------------------------------------


def test_a_reset_forgets_motion_and_torques_but_not_which_samples_came(drums: Drums) -> None:
    drums.following[:] = 1.0
    drums.torque[:] = HUGE
    drums.tick(3)
    drums.image.axes["age"][2] = 1
    drums.tick()
    assert drums.observer.most_misled > 0
    drums.observer.reset()
    assert drums.observer.most_misled == 0
    assert drums.observer.misled.tolist() == NONE
    assert drums.observer.travel.tolist() == NONE
    assert (drums.unobserved, drums.observer.longest_unobserved) == (only(2, 1), 1)
    drums.torque[:] = drums.tension[:] = drums.following[:] = 0.0
    drums.image.axes["age"][2] = 0
    assert [drums.tick() for _ in range(2)] == [NONE, NONE], "no torque is under way"
    assert drums.unobserved == only(2, 3)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_after_a_reset_the_bound_is_that_of_a_drum_without_torque(
    drums: Drums, sign: float
) -> None:
    for beyond, misled in ((0.0, NONE), (BIT, only(1, 1))):
        drums.push(1, HUGE)
        drums.observer.reset()
        drums.torque[:] = drums.tension[:] = 0.0
        assert drums.push(1, sign * (FORCE / SMOOTHING + beyond)) == misled


def test_after_a_reset_a_speed_is_no_step() -> None:
    drums = Drums(torque_error=1e9)
    drums.observer.reset()
    drums.rate[:] = 100.0
    assert drums.tick() == NONE
    drums.rate[:] = 0.0
    assert drums.tick() == [CERTAIN] * N
