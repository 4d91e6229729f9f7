"""A length that the tracker's poses contradict: which cable, and when nobody is named."""

from __future__ import annotations

import numpy as np
import pytest

from tonus.config import load
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.safety.witness import Witness

CONFIG = load("config/direct.yaml")[0]
ROBOT, CONTROL = CONFIG.robot, CONFIG.control
SETTINGS, PERIOD = CONTROL.isolation, CONTROL.rates.period
CABLES = ROBOT.cables
EVERY = round(1.0 / (CONFIG.tracker.rate_hz * PERIOD))
DELAY = 8
LONG = round(SETTINGS.witness_s / PERIOD) + 10 * EVERY


class Seen:
    """A platform that follows a path, and drums whose cables do as they like."""

    def __init__(self) -> None:
        self.witness = Witness(ROBOT, SETTINGS, CONFIG.tracker, CONTROL.stop.taut_tension, PERIOD)
        self.image = ProcessImage(CABLES)
        self.tension = np.full(CABLES, 30.0)
        self.slip, self.shift = np.zeros(CABLES), np.zeros(3)
        self.excluded = np.zeros(CABLES, dtype=bool)
        self.speed = np.array([0.1, -0.05, 0.08])
        self._kinematics, self._tick = Kinematics(ROBOT.geometry), 0

    def place(self, tick: int) -> np.ndarray:
        return np.sin(tick * PERIOD) * self.speed

    def go_on(self, ticks: int) -> int:
        """The cable named in the end."""
        tracker, level = self.image.tracker, np.array([1.0, 0.0, 0.0, 0.0])
        for _ in range(ticks):
            self._tick += 1
            # What is measured is a period old, as the witness expects it.
            self._kinematics.evaluate(self.place(self._tick - 1), level)
            tracker["fresh"] = self._tick > DELAY and self._tick % EVERY == 0
            tracker["position"] = self.place(self._tick - DELAY) + self.shift
            tracker["quaternion"], tracker["delay"] = level, DELAY * PERIOD
            lengths = self._kinematics.lengths + self.slip
            self.witness.step(self.image, lengths, self.tension, self.excluded)
        return self.witness.misread


@pytest.fixture
def seen() -> Seen:
    found = Seen()
    assert found.go_on(2 * LONG) == -1, "a sound robot in motion"
    return found


@pytest.mark.parametrize("cable", range(CABLES))
@pytest.mark.parametrize("ticks", [1, 200])
def test_a_slip_is_named(seen: Seen, cable: int, ticks: int) -> None:
    """At once, or so slowly that no length jumps; the other cables of its half look alike to the
    lengths alone."""
    for _ in range(ticks):
        seen.slip[cable] -= 1.5 * SETTINGS.witness / ticks
        seen.go_on(1)
    assert seen.go_on(5 * EVERY) == cable


def test_a_small_difference_names_nobody(seen: Seen) -> None:
    seen.slip[2] -= 0.9 * SETTINGS.witness
    assert seen.go_on(LONG) == -1


def test_an_elongation_is_known_to_a_share_of_itself(seen: Seen) -> None:
    """A cable that is softer than nominal, and pulled."""
    seen.tension[2] += 50.0
    seen.slip[2] -= 1.5 * SETTINGS.witness
    assert seen.go_on(5 * EVERY) == -1


@pytest.mark.parametrize("missing", [(), (6,)])
def test_a_tracker_that_is_moved_names_nobody(seen: Seen, missing: tuple[int, ...]) -> None:
    """Nor hides the slip that follows; without its opposite one cable has most of the shift."""
    seen.excluded[list(missing)] = True
    seen.shift = np.array([0.016, 0.012, 0.014])
    named = {seen.go_on(EVERY) for _ in range(LONG // EVERY)}
    assert named == {-1}
    seen.slip[5] -= 2.0 * SETTINGS.witness
    assert seen.go_on(5 * EVERY) == 5


def test_a_slack_cable_may_be_long_and_never_short(seen: Seen) -> None:
    seen.tension[3], seen.slip[3] = 0.0, 0.03
    assert seen.go_on(LONG) == -1
    seen.tension[3], seen.slip[3] = 30.0, 0.0
    assert seen.go_on(LONG) == -1, "taut again, as it was"
    seen.tension[3], seen.slip[3] = 0.0, -2.0 * SETTINGS.witness
    assert seen.go_on(5 * EVERY) == 3


def test_a_cable_that_has_its_name_is_not_named_again(seen: Seen) -> None:
    seen.excluded[4] = True
    seen.slip[4] -= 0.05
    assert seen.go_on(5 * EVERY) == -1


def test_with_few_taut_cables_nobody_is_named(seen: Seen) -> None:
    seen.tension[4:] = 0.0
    seen.slip[1] -= 2.0 * SETTINGS.witness
    assert seen.go_on(5 * EVERY) == -1


def test_a_new_reference_ends_it(seen: Seen) -> None:
    seen.slip[1] -= 2.0 * SETTINGS.witness
    assert seen.go_on(5 * EVERY) == 1
    seen.witness.reset()
    assert seen.witness.misread == -1
    assert seen.go_on(LONG) == -1
