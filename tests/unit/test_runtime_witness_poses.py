"""Which poses the witness takes, with which lengths it compares them, and for how long it names."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tonus.config import load
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.safety.witness import Witness

CONFIG = load("config/direct.yaml")[0]
ROBOT, CONTROL = CONFIG.robot, CONFIG.control
CABLES, TAUT = ROBOT.cables, CONTROL.stop.taut_tension
PERIOD = 2.0**-10
"""s; delays of whole periods are exact"""
LIMIT = 2.0**-8
"""m"""
COUNT = 5
"""poses until one is compared"""
LATEST = 8
"""periods that a pose may be old"""
AGREE = 3
"""poses in a row that have to agree"""
SETTINGS = CONTROL.isolation.model_copy(
    update={"witness": LIMIT, "witness_s": (COUNT - 0.5) / 100.0, "prominence": 2.0}
)
TRACKER = CONFIG.tracker.model_copy(
    update={"rate_hz": 100.0, "maximum_age_ms": LATEST * PERIOD * 1e3}
)
MM = 1e-3
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


class Still:
    """A platform that stands still; `look` is a tick with a pose, as young as one can be."""

    def __init__(self, **settings: Any) -> None:
        self.witness = Witness(ROBOT, SETTINGS.model_copy(update=settings), TRACKER, TAUT, PERIOD)
        kinematics = Kinematics(ROBOT.geometry)
        kinematics.evaluate(np.zeros(3), LEVEL)
        self.distance = kinematics.lengths.copy()
        self.gap, self.tension = np.zeros(CABLES), np.full(CABLES, 30.0)
        self.excluded = np.zeros(CABLES, dtype=bool)
        self.image = ProcessImage(CABLES)

    def tick(self, delay: float | None = None) -> int:
        """The cable that is named, after one tick; ``delay`` of its pose in periods, if it has
        one."""
        tracker = self.image.tracker
        tracker["fresh"] = delay is not None
        tracker["position"], tracker["quaternion"] = np.zeros(3), LEVEL
        tracker["delay"] = 0.0 if delay is None else delay * PERIOD
        lengths = self.distance + self.gap
        self.witness.step(self.image, lengths, self.tension, self.excluded)
        return self.witness.misread

    def look(self, count: int = 1) -> list[int]:
        return [self.tick(1.0) for _ in range(count)]


def begun(**settings: Any) -> Still:
    """Its first tick is over, which has no earlier lengths for a pose."""
    still = Still(**settings)
    assert still.tick() == -1
    return still


@pytest.fixture(params=["new", "after a reset"])
def still(request: pytest.FixtureRequest) -> Still:
    """With nothing learnt, and a calibration that is 30 mm off."""
    found = begun()
    if request.param == "after a reset":
        found.gap[2] = -60.0 * MM
        found.look(COUNT)
        found.gap[1] = -90.0 * MM
        assert found.look(AGREE)[-1] == 1
        found.witness.reset()
        assert found.tick() == -1
        found.gap[1] = 0.0
    found.gap[2] = 30.0 * MM
    return found


@pytest.mark.parametrize("since", range(COUNT + 2))
def test_a_change_has_a_name_after_three_poses_and_for_as_long_as_it_is_new(
    still: Still, since: int
) -> None:
    """Pose k is compared with pose k - 5, and there is none of before the first."""
    named = still.look(since)
    still.gap[1] = -8.0 * MM
    named += still.look(COUNT + 5)
    wrong = [k >= COUNT and k - COUNT < since <= k for k in range(len(named))]
    expected = [1 if k >= 2 and all(wrong[k - 2 : k + 1]) else -1 for k in range(len(named))]
    assert named == expected


@pytest.mark.parametrize("rate_hz", [1.0, 5.0])
def test_a_slow_tracker_names_a_cable_too(rate_hz: float) -> None:
    """Its poses are farther apart than the time over which a change is looked for."""
    still = Still()
    slow = TRACKER.model_copy(update={"rate_hz": rate_hz})
    still.witness = Witness(ROBOT, SETTINGS, slow, TAUT, PERIOD)
    still.look(10)
    still.gap[4] = -8.0 * MM
    assert still.look(AGREE) == [-1, -1, 4]


# --- the lengths of a pose -----------------------------------------------------------------------


def old_poses(still: Still, delay: float, rows: dict[int, float], count: int = 12) -> set[int]:
    """Names after poses ``delay`` periods old. The lengths of a tick are of a period before it;
    those of ticks that are as many before a pose's as ``rows`` says have the error (m) that it says
    there, all others of cable 2 one that grows."""
    apart, named = LATEST + 4, set()
    for number in range(count):
        for before in range(apart - 1, -1, -1):
            still.gap[2] = rows.get(before, -20.0 * MM * (number + 1))
            named.add(still.tick(delay if before == 0 else None))
    return named


@pytest.mark.parametrize("delay", range(1, LATEST + 2))
def test_a_pose_has_the_lengths_of_its_time(delay: int) -> None:
    assert old_poses(Still(), delay, {delay - 1: 0.0}) == {-1}
    assert 2 in old_poses(Still(), delay, {delay: 0.0})


@pytest.mark.parametrize("whole", [1, 4, LATEST - 1])
def test_a_pose_between_two_ticks_has_lengths_between_theirs(whole: int) -> None:
    """A quarter of the way back: errors of 10 mm and of 30 mm the other way cancel."""
    still = Still()
    assert old_poses(still, whole + 0.25, {whole - 1: 10.0 * MM, whole: -30.0 * MM}) == {-1}
    still.gap[2] = 0.0
    still.witness.reset()
    changed = set()
    for number in range(12):
        more = -0.7 * MM * number  # 3.5 mm in five poses
        rows = {whole - 1: 10.0 * MM + more, whole: -30.0 * MM + more}
        changed |= old_poses(still, whole + 0.25, rows, 1)
    assert changed == {-1}


@pytest.mark.parametrize("delay", [0.0, 0.5, LATEST + 1.5, LATEST + 3.0, 1e3])
def test_a_pose_that_is_younger_or_older_than_the_lengths_kept_is_left_out(delay: float) -> None:
    assert old_poses(Still(), delay, {}) == {-1}


@pytest.mark.parametrize("delay", [1.0, 1.5, 4.0, LATEST + 1.0])
def test_a_pose_from_before_the_first_lengths_is_left_out(still: Still, delay: float) -> None:
    """It would shift what follows by a pose: the cable would be named, or named later."""
    still.witness.reset()
    still.tick(delay)
    assert still.look(COUNT - 2) == [-1] * (COUNT - 2)
    still.gap[1] = -8.0 * MM
    assert still.look(6) == [-1, -1, -1, -1, 1, -1]


@pytest.mark.parametrize("what", ["length", "tension"])
def test_a_pose_without_a_measurement_is_left_out(still: Still, what: str) -> None:
    named = still.look(3)
    still.gap[1] = -8.0 * MM
    named += still.look(2)
    values = still.gap if what == "length" else still.tension
    kept, values[6] = values[6], np.nan
    assert still.look(3) == [-1] * 3
    values[6] = kept
    still.tick()
    named += still.look(4)
    assert named == [-1] * 7 + [1, -1]


@pytest.mark.parametrize(
    ("newer", "older", "named"), [(0.0, 3.0, 3), (3.0, 0.0, 3), (1.6, 0.0, -1), (0.0, 1.6, -1)]
)
def test_a_pose_between_two_ticks_has_tensions_between_theirs(
    newer: float, older: float, named: int
) -> None:
    """``newer``, ``older``: tensions, in those at which a cable pulls, of which the mean counts."""
    still, pulls = begun(), -1
    for number in range(COUNT + 1 + AGREE):
        still.gap[3] = 30.0 * MM if number > COUNT else 0.0
        still.tension[3] = older * TAUT
        still.tick()
        still.tension[3] = newer * TAUT
        pulls = still.tick(1.5)
    assert pulls == named


# --- slack ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("tension", "named"), [(TAUT, -1), (np.nextafter(TAUT, 4.0), 5)])
def test_a_cable_pulls_above_its_bound(tension: float, named: int) -> None:
    still = begun()
    still.tension[5] = tension
    still.look(COUNT)
    still.gap[5] = 8.0 * MM
    assert still.look(AGREE)[-1] == named


@pytest.mark.parametrize("change", [-3.5, 3.5, -4.5, 4.5])
def test_after_slack_a_cable_is_compared_with_its_last_pull(change: float) -> None:
    """It pulled 3 mm longer at last than before; how long it was while slack does not count."""
    still = begun()
    still.look(COUNT)
    still.gap[4] = 3.0 * MM
    still.look()
    still.tension[4], still.gap[4] = 0.0, 30.0 * MM
    assert set(still.look(3 * COUNT)) == {-1}
    still.tension[4], still.gap[4] = 30.0, (3.0 + change) * MM
    assert still.look(AGREE)[-1] == (4 if abs(change) * MM > LIMIT else -1)


@pytest.mark.parametrize("taut", [0, 1, 2])
def test_a_cable_that_was_slack_from_the_beginning_is_taken_as_it_was(
    still: Still, taut: int
) -> None:
    """``taut`` poses before; what was before a reset is not known any more."""
    still.gap[6] = 0.0 if taut else 30.0 * MM
    still.look(taut)
    still.tension[6], still.gap[6] = 0.0, 30.0 * MM
    assert set(still.look(2 * COUNT)) == {-1}
    still.tension[6], still.gap[6] = 30.0, 0.0 if taut else 30.0 * MM
    assert set(still.look(COUNT)) == {-1}


def test_a_slack_cable_has_no_elongation_to_be_unsure_of(still: Still) -> None:
    still.tension[6] = 0.0
    still.look(2)
    still.gap[6] = -1.5 * LIMIT
    assert still.look(COUNT - 2 + AGREE)[-1] == 6


def test_a_slack_cable_is_known_to_have_the_elongation_of_its_last_pull(still: Still) -> None:
    """And no other one that it had before, whose share it would be unsure of."""
    still.tension[6] = 120.0
    still.look(COUNT - 1)
    still.tension[6] = 30.0
    still.look()
    still.tension[6] = 0.0
    still.look(COUNT)
    still.tension[6], still.gap[6] = 30.0, -1.1 * LIMIT
    assert still.look(AGREE)[-1] == 6


# --- who stands out ------------------------------------------------------------------------------


def slipped(still: Still, slips: dict[int, float], steps: int = 1) -> int:
    still.look(COUNT)
    for step in range(1, steps + 1):
        for cable, slip in slips.items():
            still.gap[cable] = slip * step / steps
        still.look()
    return still.look(AGREE - 1)[-1]


@pytest.mark.parametrize("second", range(CABLES))
@pytest.mark.parametrize("first", range(CABLES))
def test_the_largest_is_named_if_the_second_is_less_than_half(first: int, second: int) -> None:
    """The others move too, by less."""
    for share, named in ((0.45, first), (0.55, -1)):
        still = begun()
        slips = {cable: -0.1 * MM * (cable + 1) for cable in range(CABLES)}
        slips[second] = -8.0 * MM * share
        slips[first] = -8.0 * MM
        if first != second:
            assert slipped(still, slips) == named


@pytest.mark.parametrize(
    ("elsewhere", "slips", "named"),
    [(0.0, LIMIT, -1), (0.0, 1.001 * LIMIT, 1), (LIMIT, 2.0 * LIMIT, -1), (LIMIT, 2.01 * LIMIT, 1)],
)
def test_a_bound_itself_names_nobody(elsewhere: float, slips: float, named: int) -> None:
    still = begun(witness_share=0.0)
    assert slipped(still, {1: -slips, 4: elsewhere}) == named


@pytest.mark.parametrize(("taut", "named"), [(5, 0), (4, -1)])
def test_five_are_compared_at_least(taut: int, named: int) -> None:
    still = begun()
    still.tension[taut:] = 0.0
    assert slipped(still, {0: -8.0 * MM}) == named


@pytest.mark.parametrize(("taut", "named"), [(4, 7), (3, -1)])
def test_a_slack_one_that_is_short_is_compared(taut: int, named: int) -> None:
    still = begun()
    still.tension[taut:] = 0.0
    assert slipped(still, {7: -8.0 * MM}) == named


def test_a_pose_between_that_names_nobody_begins_anew(still: Still) -> None:
    still.look(COUNT)
    named = []
    for gap in (-8.0, -8.0, -3.0, -8.0, -8.0):
        still.gap[1] = gap * MM
        named += still.look()
    assert named == [-1] * 5


def test_another_cable_begins_anew(still: Still) -> None:
    still.look(COUNT)
    named = []
    for cable in (1, 1, 4, 4, 4):
        still.gap[[1, 4]] = 0.0
        still.gap[cable] = -8.0 * MM
        named += still.look()
    assert named == [-1] * 4 + [4]


# --- a tracker that is moved ---------------------------------------------------------------------


@pytest.mark.parametrize("cable", range(CABLES))
def test_a_large_slip_of_one_cable_is_no_motion_of_the_tracker(cable: int) -> None:
    """A translation explains less than half of it."""
    assert slipped(begun(), {cable: -40.0 * MM}) == cable


def translation(still: Still, cable: int, by: float) -> np.ndarray:
    """Change of all lengths while a tracker moves ``by`` m towards an anchor."""
    kinematics, other = Kinematics(ROBOT.geometry), Kinematics(ROBOT.geometry)
    kinematics.evaluate(np.zeros(3), LEVEL)
    other.evaluate(by * kinematics.matrix[:3, cable], LEVEL)
    return np.asarray(kinematics.lengths - other.lengths)


def test_a_motion_that_no_tracker_makes_at_once_is_not_taken_out() -> None:
    """All lengths creep as with a translation; the opposite cable is out, so that one has most."""
    for at_once, named in ((True, -1), (False, 5)):
        still = begun()
        still.excluded[:] = True
        still.excluded[[0, 1, 4, 5, 6]] = False
        change = -translation(still, 5, 10.0 * MM)
        assert slipped(still, dict(enumerate(change)), 1 if at_once else 4) == named


def test_a_tracker_that_is_turned_is_not_taken_out() -> None:
    """No translation explains it: while it is new, it hides what is smaller, and names nobody."""
    kinematics = Kinematics(ROBOT.geometry)
    kinematics.evaluate(np.zeros(3), LEVEL)
    turned = kinematics.matrix[3]
    turned = 10.0 * MM * turned / np.abs(turned).max()
    still = begun()
    assert slipped(still, dict(enumerate(turned))) == -1
    still.gap[1] -= 8.0 * MM
    assert still.look(COUNT - AGREE) == [-1] * (COUNT - AGREE)
    assert still.look(AGREE)[-1] == 1, "the turn is as old as what it is compared with"


def test_a_motion_below_the_limit_is_left_in() -> None:
    """Just below it; what is added to it later counts with it."""
    kinematics = Kinematics(ROBOT.geometry)
    kinematics.evaluate(np.zeros(3), LEVEL)
    ways = kinematics.matrix[:3]
    for share, named in ((0.9995, 5), (1.001, -1)):
        still = begun(prominence=1.0, witness_share=0.0)
        still.look(COUNT)
        still.gap += share * LIMIT * ways[:, 5] @ ways
        still.look()
        still.gap[5] += 0.5 * LIMIT
        assert still.look(AGREE)[-1] == named


def test_a_turn_with_a_motion_is_left_in_whole() -> None:
    """The turn is most of it, and a translation explains none of that."""
    kinematics = Kinematics(ROBOT.geometry)
    kinematics.evaluate(np.zeros(3), LEVEL)
    ways, turned = kinematics.matrix[:3], kinematics.matrix[3]
    still = begun(prominence=1.5)
    still.excluded[1:4] = True
    moved = 40.0 * MM * turned / turned[0] + 1.3 * LIMIT * ways[:, 0] @ ways
    assert slipped(still, dict(enumerate(moved))) == 0


def test_a_turn_is_left_in_whole() -> None:
    """Of five cables the first changes 1.8 times as much as the others, and stands out."""
    kinematics = Kinematics(ROBOT.geometry)
    kinematics.evaluate(np.zeros(3), LEVEL)
    turned = kinematics.matrix[3]
    still = begun(prominence=1.5)
    still.excluded[1:4] = True
    assert slipped(still, dict(enumerate(10.0 * MM * turned / turned[0]))) == 0
