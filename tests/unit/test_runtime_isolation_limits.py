"""The bounds of each residual, in ticks and to the last bit, and what makes a count begin anew."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tonus.config import load
from tonus.runtime.safety.isolation import Isolation
from tonus.runtime.states import Fault, StopMode

Array = NDArray[np.float64]
CONFIG, _ = load("config/can.yaml")
CABLES, CELLS = CONFIG.robot.cables, CONFIG.robot.cells
CONTROL = CONFIG.control
PERIOD = CONTROL.rates.period
SETTINGS = CONTROL.isolation
TAUT = CONTROL.stop.taut_tension
PULL = 45.0
NOTHING = (Fault.NONE, -1)
JUMP, MEAN = SETTINGS.length_jump, SETTINGS.innovation
DESCENT = SETTINGS.innovation_descent
ASTRAY = round(SETTINGS.tension_error_s / PERIOD)
STRAY = round(SETTINGS.innovation_descent_s / PERIOD)
TIME = SETTINGS.innovation_s / PERIOD
"""ticks, time constant of a mean innovation"""


class Residuals:
    """What is given to the isolation: sound cables, of which a test changes some."""

    def __init__(self, **settings: Any) -> None:
        known = SETTINGS.model_copy(update=settings)
        self.isolation = Isolation(CONFIG.robot, known, CONTROL.stop, PERIOD)
        self.innovation, self.doubt = np.zeros(CABLES), np.zeros(CABLES)
        self.reference, self.tension = np.full(CABLES, PULL), np.full(CABLES, PULL)
        self.watched = np.ones(CABLES, dtype=bool)
        self.age = np.zeros(CELLS, dtype=np.uint16)
        self.frozen = np.zeros(CELLS, dtype=bool)
        self._raw = np.full(CELLS, PULL)

    def tick(self, count: int = 1) -> tuple[Fault, int]:
        for _ in range(count):
            self._raw = np.where(self.frozen, self._raw, 2.0 * PULL - self._raw + 1.0)
            self.isolation.step(
                self.innovation,
                self.doubt,
                self.reference,
                self.tension,
                self.watched,
                self._raw,
                self.age,
                self.tension,
            )
        return self.isolation.found(self.tension)

    def until(self, fault: Fault, most: int = 300) -> int:
        """Ticks to this fault; until then there is none."""
        for count in range(1, most):
            found = self.tick()
            if found[0] is fault:
                return count
            assert found == NOTHING
        raise AssertionError("it is never found")

    def descent(self, stray: Array, ticks: int) -> int:
        """The cable whose length is wrong, after ticks of a descent."""
        for _ in range(ticks):
            self.isolation.lengths(stray, self.watched)
        return self.isolation.misread

    @property
    def descending(self) -> tuple[Fault, int]:
        return self.isolation.disobedient(StopMode.DESCENT, ~self.watched)

    @property
    def elsewhere(self) -> tuple[tuple[Fault, int], ...]:
        """In every other mode, where neither a slack cable nor a frozen cell is looked for."""
        others = [mode for mode in StopMode if mode is not StopMode.DESCENT]
        return tuple(self.isolation.disobedient(mode, ~self.watched) for mode in others)


@pytest.fixture
def given() -> Residuals:
    found = Residuals()
    assert found.isolation.found(found.tension) == NOTHING, "before the first tick"
    assert found.tick(3) == NOTHING
    return found


def frozen(given: Residuals, *cells: int) -> None:
    """Their readings repeat from the next tick on, and would have to follow the references."""
    given.frozen[list(cells)] = True
    given.reference = np.full(CABLES, PULL + 1.5 * SETTINGS.frozen_change)


# --- in ticks ------------------------------------------------------------------------------------


def jumping(given: Residuals) -> None:
    given.innovation[2] = 1.01 * JUMP


def astray(given: Residuals) -> None:
    given.reference[2] += 1.01 * SETTINGS.tension_error


def repeating(given: Residuals) -> None:
    frozen(given, 2)


EACH = [
    (jumping, Fault.LENGTH_JUMP, SETTINGS.jump_ticks),
    (astray, Fault.TENSION_ERROR, ASTRAY),
    (repeating, Fault.CELL_FROZEN, SETTINGS.frozen_ticks),
]


@pytest.mark.parametrize(("change", "fault", "ticks"), EACH)
@pytest.mark.parametrize("by", ["watched", "reset"])
def test_a_count_begins_anew(
    given: Residuals, change: Callable[[Residuals], None], fault: Fault, ticks: int, by: str
) -> None:
    """One tick before its fault the cable is not watched for a tick, or all is reset. A cell is a
    cell without its cable, too."""
    change(given)
    assert given.tick(ticks - 1) == NOTHING
    if by == "reset":
        given.isolation.reset()
    elif fault is not Fault.CELL_FROZEN:
        given.watched[2] = False
        assert given.tick() == NOTHING
        given.watched[2] = True
    assert given.until(fault) == (1 if by == "watched" and fault is Fault.CELL_FROZEN else ticks)


@pytest.mark.parametrize("ticks", [1, 2, 3])
def test_a_small_jump_is_found_in_the_tick_that_is_set(ticks: int) -> None:
    """Its mean is still within the bound of a mean."""
    given = Residuals(jump_ticks=ticks, innovation=2.0 * MEAN)
    jumping(given)
    assert given.until(Fault.LENGTH_JUMP) == ticks


def test_a_tension_error_needs_no_frozen_cell() -> None:
    given = Residuals(frozen_ticks=2 * ASTRAY)
    astray(given)
    assert given.until(Fault.TENSION_ERROR) == ASTRAY


def test_all_at_once_are_found(given: Residuals) -> None:
    """A tracker, a clock, a supply: nothing that all cables share hides it."""
    given.innovation[:] = 1.01 * JUMP
    assert given.tick(SETTINGS.jump_ticks) == (Fault.LENGTH_JUMP, 0)
    given = Residuals()
    given.reference += 1.01 * SETTINGS.tension_error
    assert given.tick(ASTRAY) == (Fault.TENSION_ERROR, 0)
    given = Residuals()
    given.tick(3)
    frozen(given, *range(CABLES))
    assert given.tick(SETTINGS.frozen_ticks) == (Fault.CELL_FROZEN, 0)
    given = Residuals()
    for _ in range(200):
        given.innovation[:] = 2.0 * JUMP
        given.tick()
        given.innovation[:] = 0.9 * JUMP
        found = given.tick()
    assert found == (Fault.LENGTH_DRIFT, -1)


# --- to the last bit -----------------------------------------------------------------------------


def test_a_bound_itself_is_no_fault(given: Residuals) -> None:
    given.innovation[3] = JUMP
    assert given.tick() == NOTHING
    assert given.tick()[0] is not Fault.LENGTH_JUMP
    given = Residuals()
    given.reference[3] += SETTINGS.tension_error
    assert given.tick(2 * ASTRAY) == NOTHING


@pytest.mark.parametrize(("tension", "fault"), [(TAUT, Fault.LENGTH_JUMP), (2.9, Fault.CABLE_TORN)])
def test_a_cable_is_torn_below_its_bound(given: Residuals, tension: float, fault: Fault) -> None:
    given.innovation[3], given.tension[3], given.reference[3] = 2.0 * JUMP, tension, tension
    assert given.tick(2) == (fault, 3)


@pytest.mark.parametrize(
    ("tension", "change", "is_frozen"),
    [
        (TAUT, 1.01, False),
        (np.nextafter(TAUT, 4.0), 1.01, True),
        (PULL, 1.0, False),
        (PULL, -1.0, False),
        (PULL, -1.01, True),
    ],
)
def test_a_cell_is_frozen_under_load_beyond_a_change(
    tension: float, change: float, *, is_frozen: bool
) -> None:
    given = Residuals(frozen_change=2.0, frozen_step=8.0)
    given.tension[:] = given.reference[:] = tension
    given.tick(3)
    given.frozen[4] = True
    given.reference[4] += 2.0 * change
    assert given.tick(100) == ((Fault.CELL_FROZEN, 4) if is_frozen else NOTHING)


@pytest.mark.parametrize("every", [1, 2, 3])
def test_only_fresh_readings_repeat(given: Residuals, every: int) -> None:
    frozen(given, 4)
    for tick in range(1, every * SETTINGS.frozen_ticks + 1):
        given.age[4] = 0 if tick % every == 0 else 1
        found = given.tick()
        assert (found[0] is Fault.CELL_FROZEN) == (tick == every * SETTINGS.frozen_ticks)
    given.age[4] = 1
    assert given.tick(50) == (Fault.CELL_FROZEN, 4), "nothing new says otherwise"


def test_readings_that_are_not_fresh_never_repeat(given: Residuals) -> None:
    given.age[:] = 1
    frozen(given, 4)
    assert given.tick(200) == NOTHING
    assert given.descending == NOTHING


# --- a mean --------------------------------------------------------------------------------------


@pytest.mark.parametrize("ticks", [1, 7, 40])
def test_a_mean_follows_in_its_time_and_is_bounded(given: Residuals, ticks: int) -> None:
    """One sample that is far off counts as two jumps."""
    given.innovation[:3] = 0.5 * JUMP, 7.0, -7.0
    given.watched[5], given.innovation[5] = False, 7.0
    given.tick(ticks)
    shown = 1.0 - math.exp(-ticks / TIME)
    expected = np.zeros(CABLES)
    expected[:3] = 0.5 * JUMP * shown, 2.0 * JUMP * shown, -2.0 * JUMP * shown
    assert given.isolation.drift == pytest.approx(expected, rel=1e-9)
    given.isolation.reset()
    assert not given.isolation.drift.any()
    given.tick()
    given.watched[:] = False
    given.tick()
    assert not given.isolation.drift.any()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_an_elongation_may_be_wrong_by_is_not_in_the_mean(
    given: Residuals, sign: float
) -> None:
    sigmas = SETTINGS.elongation_doubt
    given.doubt[2] = 3.0 * MEAN / sigmas
    given.innovation[2] = 3.9 * MEAN * sign
    assert given.tick(300) == NOTHING
    assert given.isolation.drift[2] == pytest.approx(0.9 * MEAN * sign, rel=1e-3)
    given.doubt[2] = 0.0
    assert given.until(Fault.LENGTH_DRIFT) < TIME


def test_an_elongation_that_may_be_wrong_by_more_says_nothing(given: Residuals) -> None:
    given.doubt[2] = 3.0 * MEAN
    given.innovation[2] = 0.5 * MEAN
    assert given.tick(300) == NOTHING
    assert given.isolation.drift[2] == 0.0


def test_a_tick_without_an_innovation_changes_no_count_and_no_mean(given: Residuals) -> None:
    given.innovation[2] = 0.9 * MEAN
    assert given.tick(300) == NOTHING
    drift = given.isolation.drift[2]
    given.innovation[2] = np.nan
    assert given.tick(300) == NOTHING
    assert given.isolation.drift[2] == drift
    given.innovation[2] = 1.1 * JUMP
    assert given.tick() == NOTHING
    given.innovation[2] = np.nan
    assert given.tick() == NOTHING
    given.innovation[2] = 1.1 * JUMP
    assert given.tick() == (Fault.LENGTH_JUMP, 2)


def test_a_jump_counts_whatever_the_elongation_may_be_wrong_by(given: Residuals) -> None:
    given.doubt[4] = JUMP
    given.innovation[4] = 1.1 * JUMP
    assert given.tick() == NOTHING
    assert given.tick() == (Fault.LENGTH_JUMP, 4)


def test_a_jump_is_not_named_by_the_mean_that_it_moves(given: Residuals) -> None:
    given.innovation[1] = 0.95 * MEAN
    assert given.tick(200) == NOTHING
    given.innovation[1] = 10.0 * JUMP
    assert given.tick() == NOTHING
    assert given.tick() == (Fault.LENGTH_JUMP, 1)


@pytest.mark.parametrize("second", range(CABLES))
@pytest.mark.parametrize("first", range(CABLES))
def test_a_mean_that_stands_out_is_twice_the_second(first: int, second: int) -> None:
    """Others have small ones. What is half of the largest to the last bit is too much."""
    for share, named in ((0.49, first), (0.5, -1), (0.6, -1)):
        given = Residuals(prominence=2.0)
        values = -0.1 * np.arange(1.0, CABLES + 1.0) / CABLES
        values[second] = share
        values[first] = -1.0
        given.innovation = 8.0 * MEAN * values
        if first != second:
            found = (Fault.LENGTH_DRIFT, named) if named >= 0 else NOTHING
            assert given.tick(12) == found
            assert given.descent(4.0 * DESCENT * values, STRAY + 60) == named


def test_a_mean_within_its_bound_hides_no_frozen_cell(given: Residuals) -> None:
    given.innovation[0] = 0.9 * MEAN
    frozen(given, 4)
    assert given.until(Fault.CELL_FROZEN) == SETTINGS.frozen_ticks
    assert given.tick() == (Fault.CELL_FROZEN, 4)


# --- a descent -----------------------------------------------------------------------------------


def alone(cable: int, innovation: float) -> Array:
    found = np.zeros(CABLES)
    found[cable] = innovation
    return found


def test_a_wrong_length_is_named_in_the_tick_that_is_set(given: Residuals) -> None:
    """A mean of twice the bound needs ln 2 times its time; what was before a descent is void."""
    wrong = alone(5, 2.0 * DESCENT)
    beyond = math.ceil(TIME * math.log(2.0))
    for _ in range(2):
        assert given.descent(wrong, beyond + STRAY - 2) == -1
        assert given.descent(wrong, 1) == 5
        given.descent(wrong, 100)
        given.isolation.descend()
        assert given.isolation.misread == -1
    for _ in range(2):
        assert given.descent(alone(5, 1.0), STRAY - 1) == -1
        assert given.descent(alone(5, 1.0), 1) == 5
        given.isolation.descend()


def test_a_slack_cable_that_is_wound_up_further_than_its_way_is_torn() -> None:
    given, no_cable = Residuals(overwound=0.0625), np.zeros(CABLES, dtype=bool)
    length, slack = np.full(CABLES, 1.0), no_cable.copy()
    slack[[3, 6]] = True
    for short, torn in ((0.0625, NOTHING), (0.07, (Fault.CABLE_TORN, 6)), (-0.07, NOTHING)):
        given.isolation.reeled(length + alone(6, short), length, slack)
        assert given.descending == torn
        assert set(given.elsewhere) == {NOTHING}
        given.isolation.reeled(length + alone(5, short), length, slack)
        assert given.descending == NOTHING, "it pulls"
    given.isolation.reeled(length + 0.07, length, slack)
    assert given.descending == (Fault.CABLE_TORN, 3)
    given.isolation.reset()
    assert given.descending == NOTHING


@pytest.mark.parametrize("ticks", [1, 25])
def test_a_frozen_cell_is_found_in_a_descent_in_its_tick(ticks: int) -> None:
    given = Residuals(frozen_ticks=ticks)
    given.tick(3)
    frozen(given, 4)
    given.tick(ticks - 1)
    assert given.descending == NOTHING
    given.tick()
    assert given.descending == (Fault.CELL_FROZEN, 4)
    assert set(given.elsewhere) == {NOTHING}
    given.isolation.reset()
    assert given.descending == NOTHING


def test_a_frozen_cell_that_has_its_name_hides_no_other() -> None:
    given = Residuals(frozen_ticks=5)
    given.tick(3)
    frozen(given, 2, 4)
    given.tick(5)
    assert given.descending == (Fault.CELL_FROZEN, 2)
    given.watched[2] = False
    assert given.descending == (Fault.CELL_FROZEN, 4)


def test_a_force_that_is_frozen_under_its_noise_is_counted_anew_after_a_reset() -> None:
    given = Residuals(frozen_band=2.0, frozen_step=8.0)  # readings change by 1 N
    given.reference[4] += 8.0
    given.tick(3)
    given.reference[4] += 1.0
    given.tick(100)
    assert given.descending == NOTHING, "8 N themselves are not beyond"
    given.reference[4] += 8.0
    for _ in range(2):
        given.tick(SETTINGS.frozen_ticks - 1)
        assert given.descending == NOTHING
        given.isolation.reset()
    given.tick(SETTINGS.frozen_ticks)
    assert given.descending == (Fault.CELL_FROZEN, 4)


# --- drums ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", StopMode)
def test_a_drum_is_misled_for_the_ticks_that_are_set(given: Residuals, mode: StopMode) -> None:
    ticks = SETTINGS.torque_descent_ticks if mode > StopMode.ON_PATH else SETTINGS.torque_ticks
    drums = given.isolation.drums
    for misled, found in ((ticks - 1, NOTHING), (ticks, (Fault.DRUM_TORQUE, 6))):
        drums.misled[6] = drums.most_misled = misled
        assert given.isolation.disobedient(mode, ~given.watched) == found
    given.isolation.reset()
    assert given.isolation.disobedient(mode, ~given.watched) == NOTHING


@pytest.mark.parametrize("mode", StopMode)
def test_a_drum_that_stands_against_its_torque_is_found_as_fast_in_a_descent(
    given: Residuals, mode: StopMode
) -> None:
    """Cables that snap taut turn their drums: none of these stands to the last increment."""
    ticks, drums = SETTINGS.torque_ticks, given.isolation.drums
    drums.misled[5] = drums.most_misled = ticks
    rough = mode > StopMode.ON_PATH
    for standing in range(2 * ticks):
        drums.standing[:] = 1000
        drums.standing[5] = standing
        stuck = not rough or standing >= ticks
        found = (Fault.DRUM_TORQUE, 5) if stuck else NOTHING
        assert given.isolation.disobedient(mode, ~given.watched) == found


@pytest.mark.parametrize("mode", [StopMode.DESCENT, StopMode.PASSIVE])
def test_one_that_stands_is_found_beside_one_that_turns(given: Residuals, mode: StopMode) -> None:
    drums, ticks = given.isolation.drums, SETTINGS.torque_ticks
    drums.misled[2] = drums.most_misled = SETTINGS.torque_descent_ticks - 1
    assert given.isolation.disobedient(mode, ~given.watched) == NOTHING
    drums.misled[6], drums.standing[6] = ticks, 1000
    assert given.isolation.disobedient(mode, ~given.watched) == (Fault.DRUM_TORQUE, 6)


def test_a_reading_that_moves_by_more_than_its_noise_is_no_frozen_one(given: Residuals) -> None:
    """By 1 N, while its reference has gone on far enough."""
    given.reference[2] += 1.2 * SETTINGS.frozen_step
    given.tick(2 * SETTINGS.frozen_ticks)
    assert given.descending == NOTHING


def test_a_cell_that_reads_nothing_from_the_first_tick_on() -> None:
    """What it should have followed is what was asked of it since then."""
    isolation, none = Residuals().isolation, np.zeros(CABLES)
    pull, raw, age = np.full(CABLES, PULL), np.zeros(CELLS), np.zeros(CELLS, dtype=np.uint16)
    for _ in range(2 * SETTINGS.frozen_ticks):
        isolation.step(none, none, pull, pull, np.ones(CABLES, dtype=bool), raw, age, pull)
    assert isolation.found(pull) == NOTHING
    assert isolation.disobedient(StopMode.DESCENT, none.astype(bool)) == NOTHING


@pytest.mark.parametrize("doubts", [2.0, 4.0])
def test_how_many_doubts_of_its_elongation_a_mean_leaves_out(doubts: float) -> None:
    given = Residuals(elongation_doubt=doubts)
    given.doubt[2] = 0.1 * JUMP
    given.innovation[2] = doubts * given.doubt[2] + 0.2 * JUMP
    given.tick()
    share = 1.0 - math.exp(-1.0 / TIME)
    assert given.isolation.drift[2] == pytest.approx(share * 0.2 * JUMP)


@pytest.mark.parametrize(
    ("pull", "moved", "turned", "found"),
    [
        (1.01 * SETTINGS.torque_error, SETTINGS.frozen_band, 1.01, (Fault.CELL_FROZEN, 5)),
        (SETTINGS.torque_error, SETTINGS.frozen_band, 1.01, NOTHING),
        (1.01 * SETTINGS.torque_error, 1.01 * SETTINGS.frozen_band, 1.01, NOTHING),
        (1.01 * SETTINGS.torque_error, SETTINGS.frozen_band, 1.0, NOTHING),
    ],
)
def test_each_bound_of_a_drum_that_pays_out_at_one_force(
    given: Residuals, pull: float, moved: float, turned: float, found: tuple[Fault, int]
) -> None:
    """From wherever it stands, which a reading does not change."""
    held, tension = np.arange(CABLES) == 5, np.full(CABLES, pull)
    way = SETTINGS.frozen_travel / CONFIG.robot.drum.radius
    assert way * CONFIG.robot.drum.radius == SETTINGS.frozen_travel
    for raw, share in ((0.0, 0.0), (0.0, 0.0), (moved, turned)):
        readings, angle = np.full(CABLES, raw), np.full(CABLES, 2.0 + share * way)
        given.isolation.unwound(readings, given.age[:CABLES], tension, angle, held)
        if share == 0.0:
            assert given.isolation.disobedient(StopMode.DESCENT, held) == NOTHING
    assert given.isolation.disobedient(StopMode.DESCENT, held) == found


@pytest.mark.parametrize(("pulses", "ticks"), [(1024, 3), (64, 9), (16, 17)])
def test_a_drum_has_to_stand_for_as_long_as_a_coarse_encoder_may_hide_a_motion(
    pulses: int, ticks: int
) -> None:
    """Until the smallest force that counts would have turned it by two increments."""
    robot = CONFIG.robot
    motor = robot.motor.model_copy(update={"encoder_pulses": pulses})
    robot = robot.model_copy(update={"motor": motor})
    increment = 2.0 * math.pi / (4 * pulses * robot.gearbox.ratio) * robot.drum.radius
    mass = robot.drum.inertia / robot.drum.radius**2
    turned = math.sqrt(2.0 * 2.0 * increment * mass / SETTINGS.torque_error)
    assert ticks == max(SETTINGS.torque_ticks, math.ceil(turned / PERIOD))
    isolation = Isolation(robot, SETTINGS, CONTROL.stop, PERIOD)
    none = np.zeros(CABLES, dtype=bool)
    drums = isolation.drums
    for standing, found in ((ticks - 1, NOTHING), (ticks, (Fault.DRUM_TORQUE, 3))):
        drums.misled[3] = drums.most_misled = drums.standing[3] = standing
        assert isolation.disobedient(StopMode.DESCENT, none) == found


def test_a_drum_is_stuck_only_where_a_length_contradicts(given: Residuals) -> None:
    travel = given.isolation.drums.travel
    travel[:] = 0.5 * SETTINGS.travel
    travel[6] = -1.01 * SETTINGS.travel
    jumping(given)
    given.innovation[6] = 0.6 * JUMP
    assert given.tick() == NOTHING, "one odd sample"
    assert given.tick() == (Fault.DRUM_STUCK, 6)
    travel[6] = -SETTINGS.travel
    assert given.tick() == (Fault.LENGTH_JUMP, 2)
    given = Residuals()
    given.isolation.drums.travel[6] = -1.01 * SETTINGS.travel
    astray(given)
    assert given.tick(ASTRAY) == (Fault.TENSION_ERROR, 2)


@pytest.mark.parametrize(
    ("share", "found"),
    [
        (0.0, (Fault.LENGTH_JUMP, 2)),
        (0.99, (Fault.LENGTH_JUMP, 2)),
        (1.0, (Fault.DRUM_STUCK, 6)),
        (-1.0, (Fault.DRUM_STUCK, 6)),
    ],
)
def test_a_drum_that_friction_holds_is_not_why_another_length_is_wrong(
    share: float, found: tuple[Fault, int]
) -> None:
    """Unless its own is nearly as wrong."""
    fault, place = found
    for cable in (2, 0):
        given = Residuals()
        given.isolation.drums.travel[6] = 2.0 * SETTINGS.travel
        given.innovation[cable] = 1.01 * JUMP
        given.innovation[6] = share / SETTINGS.prominence * given.innovation[cable]
        assert given.tick(SETTINGS.jump_ticks) == (fault, 6 if place == 6 else cable)


def test_a_drum_that_stands_is_why_lengths_contradict_of_which_none_stands_out() -> None:
    given = Residuals()
    given.isolation.drums.travel[6] = 2.0 * SETTINGS.travel
    for innovation in (2.0 * JUMP, 0.9 * JUMP) * 200:
        given.innovation[:] = innovation
        given.innovation[6] = 0.0
        found = given.tick()
    assert found == (Fault.DRUM_STUCK, 6)
