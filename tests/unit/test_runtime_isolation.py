"""Each residual by itself names its fault and its cable, and a sound cable shows none."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.observed import observe
from tonus.config import load
from tonus.runtime.safety.isolation import Isolation
from tonus.runtime.states import Fault, StopMode

Array = NDArray[np.float64]
CONFIG, _ = load("config/can.yaml")
CABLES, CELLS = CONFIG.robot.cables, CONFIG.robot.cells
CONTROL = CONFIG.control
PERIOD, RADIUS = CONTROL.rates.period, CONFIG.robot.drum.radius
SETTINGS = CONTROL.isolation
ALL = np.ones(CABLES, dtype=bool)
FRESH = np.zeros(CELLS, dtype=np.uint16)
INTERVAL = np.full(CABLES, PERIOD)
PULL = 45.0
NOISE = 0.05
"""N, of a load cell, as in the lab"""


class Watched:
    """Cables at rest under equal tension; a test changes what one of them reports."""

    def __init__(self) -> None:
        self.isolation = Isolation(CONFIG.robot, SETTINGS, CONTROL.stop, PERIOD)
        self.given: dict[str, Array] = {
            "innovation": np.zeros(CABLES),
            "doubt": np.zeros(CABLES),
            "reference": np.full(CABLES, PULL),
            "tension": np.full(CABLES, PULL),
            "angle": np.zeros(CABLES),
            "rate": np.zeros(CABLES),
            "torque": np.full(CABLES, RADIUS * PULL),
            "following": np.zeros(CABLES),
        }
        self.watched = ALL.copy()
        self.mode = StopMode.NONE
        self._random = np.random.default_rng(1)
        self.repeats: int | None = None
        """cell whose reading repeats"""
        self._raw = np.zeros(CELLS)

    def tick(self, count: int = 1) -> tuple[Fault, int]:
        given = self.given
        for _ in range(count):
            given["angle"] = given["angle"] + PERIOD * given["rate"]
            raw = self._random.normal(PULL, NOISE, CELLS)
            if self.repeats is not None:
                raw[self.repeats] = self._raw[self.repeats]
            self._raw = raw
            self.isolation.step(
                given["innovation"],
                given["doubt"],
                given["reference"],
                given["tension"],
                self.watched,
                raw,
                FRESH,
                given["tension"],
            )
            observe(
                self.isolation.drums,
                given["angle"],
                given["rate"],
                given["torque"],
                given["tension"],
                given["following"],
                self.watched,
                INTERVAL,
            )
        drum = self.isolation.disobedient(self.mode, ~self.watched)
        return drum if drum[0] is not Fault.NONE else self.isolation.found(given["tension"])

    def found_after(self, most: int) -> tuple[Fault, int, int]:
        """The first fault, its place, and the tick in which it is found."""
        for tick in range(1, most + 1):
            fault, place = self.tick()
            if fault is not Fault.NONE:
                return fault, place, tick
        return Fault.NONE, -1, most


@pytest.fixture
def cables() -> Watched:
    watched = Watched()
    assert watched.tick(200) == (Fault.NONE, -1)
    return watched


def test_a_length_that_jumps_while_its_cable_stops_pulling_is_a_torn_cable(cables: Watched) -> None:
    cables.given["innovation"][3] = 2.0 * SETTINGS.length_jump
    cables.given["tension"][3] = 0.0
    assert cables.found_after(50) == (Fault.CABLE_TORN, 3, SETTINGS.jump_ticks)


def test_a_length_that_jumps_while_its_cable_pulls_has_slipped(cables: Watched) -> None:
    cables.given["innovation"][6] = -2.0 * SETTINGS.length_jump
    assert cables.found_after(50) == (Fault.LENGTH_JUMP, 6, SETTINGS.jump_ticks)


LONG = round(SETTINGS.innovation_descent_s / PERIOD)


def misread(cables: Watched, stray: Array, believed: Array = ALL, ticks: int = 2 * LONG) -> int:
    for _ in range(ticks):
        cables.isolation.lengths(stray, believed)
    return cables.isolation.misread


def test_a_length_that_stands_out_in_a_descent_is_named_after_a_while(cables: Watched) -> None:
    stray = np.full(CABLES, 0.2 * SETTINGS.innovation_descent)
    assert misread(cables, stray) == -1
    stray[5] = -2.0 * SETTINGS.innovation_descent
    assert misread(cables, stray, ticks=LONG - 1) == -1
    assert misread(cables, stray) == 5
    cables.isolation.descend()
    assert cables.isolation.misread == -1


def test_lengths_that_are_wrong_together_name_no_cable(cables: Watched) -> None:
    """A platform that is pushed, or a pose that is wrong."""
    stray = np.full(CABLES, 2.0 * SETTINGS.innovation_descent)
    stray[2] *= 0.9 * SETTINGS.prominence
    assert misread(cables, stray) == -1


def test_a_slack_cable_in_a_descent_says_nothing(cables: Watched) -> None:
    stray = np.zeros(CABLES)
    stray[1] = 3.0 * SETTINGS.innovation_descent
    assert misread(cables, stray, np.arange(CABLES) != 1) == -1


def test_one_odd_sample_is_no_jump(cables: Watched) -> None:
    for innovation in (2.0 * SETTINGS.length_jump, 0.0) * 5:
        cables.given["innovation"][2] = innovation
        assert cables.tick()[0] not in (Fault.CABLE_TORN, Fault.LENGTH_JUMP)


def test_a_sample_that_is_not_there_counts_for_nothing(cables: Watched) -> None:
    cables.given["innovation"][:] = np.nan
    assert cables.tick(500) == (Fault.NONE, -1)
    assert np.isfinite(cables.isolation.drift).all()


@pytest.mark.parametrize("error", [-1.1, 1.1])
def test_a_tension_that_does_not_follow_is_named(cables: Watched, error: float) -> None:
    cables.given["reference"][1] += error * SETTINGS.tension_error
    ticks = round(SETTINGS.tension_error_s / PERIOD)
    assert cables.found_after(2 * ticks) == (Fault.TENSION_ERROR, 1, ticks)


def test_a_tension_error_within_its_bound_is_none(cables: Watched) -> None:
    cables.given["reference"][1] += 0.9 * SETTINGS.tension_error
    assert cables.tick(1000) == (Fault.NONE, -1)


def test_a_drum_that_does_not_turn_as_its_torque_has_it_is_named(cables: Watched) -> None:
    beyond = SETTINGS.torque_error + SETTINGS.torque_share * 4.0 * PULL
    cables.given["torque"][5] = RADIUS * (PULL + 2.0 * beyond)
    fault, place, tick = cables.found_after(100)
    assert (fault, place) == (Fault.DRUM_TORQUE, 5)
    assert tick <= round(5.0 * SETTINGS.torque_s / PERIOD)


@pytest.mark.parametrize("mode", [StopMode.DESCENT, StopMode.PASSIVE])
def test_a_stop_off_the_path_has_more_patience_with_a_drum(cables: Watched, mode: StopMode) -> None:
    """In a passive stop a drum that was named wrongly would lose its damping; none with one that
    stands, which no cable that snaps taut makes of a sound one."""
    cables.mode = mode
    cables.given["rate"][5] = 0.1
    cables.tick(100)
    cables.given["torque"][5] = RADIUS * (PULL + 10.0 * SETTINGS.torque_error)
    fault, place, tick = cables.found_after(100)
    assert (fault, place) == (Fault.DRUM_TORQUE, 5)
    assert tick >= SETTINGS.torque_descent_ticks > SETTINGS.torque_ticks
    standing = Watched()
    standing.tick(200)
    standing.mode = mode
    standing.given["torque"][5] = RADIUS * (PULL + 10.0 * SETTINGS.torque_error)
    fault, place, found = standing.found_after(100)
    assert (fault, place) == (Fault.DRUM_TORQUE, 5)
    assert SETTINGS.torque_ticks <= found < tick - 10


@pytest.mark.parametrize("mode", [StopMode.NONE, StopMode.DESCENT, StopMode.PASSIVE])
@pytest.mark.parametrize(("start", "most"), [(4.0, 0.99), (0.0, 1.0)])
def test_a_drum_that_stood_when_it_was_named_and_turns_is_free(
    cables: Watched, mode: StopMode, start: float, most: float
) -> None:
    """Either way round, and far; one that turned against its torque may be reversed."""
    cables.mode = mode
    cables.given["torque"][5] = RADIUS * (PULL + 10.0 * SETTINGS.torque_error)
    cables.given["rate"][2] = 0.1
    cables.tick(50)
    cables.given["torque"][2] = RADIUS * (PULL + 10.0 * SETTINGS.torque_error)
    assert cables.tick(100)[0] is Fault.DRUM_TORQUE
    angle = np.full(CABLES, start)
    assert not cables.isolation.freed(angle).any(), "from here on"
    for way, free in ((most, False), (1.01, True), (-1.01, True)):
        turned = angle + way * SETTINGS.freed_travel / RADIUS
        assert cables.isolation.freed(turned).tolist() == [free and n == 5 for n in range(CABLES)]
    cables.isolation.reset()
    assert not cables.isolation.freed(angle).any()
    assert not cables.isolation.freed(turned).any(), "nothing has stood since"


def test_friction_within_its_bound_is_none(cables: Watched) -> None:
    cables.given["torque"][5] = RADIUS * (PULL + 0.9 * SETTINGS.torque_error)
    assert cables.tick(500) == (Fault.NONE, -1)


def test_a_drum_that_stands_where_the_platform_would_turn_it_is_stuck(cables: Watched) -> None:
    """The others turn with the platform; only a contradicting length makes it a fault."""
    found: set[tuple[Fault, int]] = set()
    for n in range(100):
        moving = np.full(CABLES, min(n, 80) * 1e-3)
        cables.given["following"], cables.given["rate"] = moving / RADIUS, moving / RADIUS
        cables.given["rate"][4] = 0.0
        cables.given["angle"] = cables.given["angle"] + cables.given["rate"] * PERIOD
        if n == 90:
            assert found == {(Fault.NONE, -1)}
            cables.given["innovation"][[4, 7]] = np.array([0.9, 1.6]) * SETTINGS.length_jump
        found.add(cables.tick())
    assert found == {(Fault.NONE, -1), (Fault.DRUM_STUCK, 4)}


def test_a_mean_innovation_that_stands_out_names_its_cable(cables: Watched) -> None:
    cables.given["innovation"][:] = 0.4 * SETTINGS.innovation
    cables.given["innovation"][0] = 1.5 * SETTINGS.innovation
    fault, place, tick = cables.found_after(1000)
    assert (fault, place) == (Fault.LENGTH_DRIFT, 0)
    assert tick <= round(5.0 * SETTINGS.innovation_s / PERIOD)


def test_cables_that_contradict_each_other_alike_name_none(cables: Watched) -> None:
    """Half of them go astray together: not one cable, and the pose is not to be relied on."""
    for n in range(400):
        beyond = n % 2 == 0
        cables.given["innovation"][:4] = (2.0 if beyond else 0.9) * SETTINGS.length_jump
        found = cables.tick()
    assert found == (Fault.LENGTH_DRIFT, -1)


def test_a_cell_under_load_that_repeats_itself_is_frozen(cables: Watched) -> None:
    cables.repeats = 2
    assert cables.tick(200)[0] is Fault.NONE, "nothing should change it"
    cables.given["reference"][2] += 1.5 * SETTINGS.frozen_change
    fault, place, tick = cables.found_after(200)
    assert (fault, place, tick) == (Fault.CELL_FROZEN, 2, SETTINGS.frozen_ticks)


@pytest.mark.parametrize("mode", StopMode)
def test_a_force_that_is_frozen_under_its_noise_is_found_in_a_descent(
    cables: Watched, mode: StopMode
) -> None:
    """Elsewhere the tension error or the drum's torque finds it: a drum may be what holds it."""
    cables.mode = mode
    cables.given["reference"][2] += 1.2 * SETTINGS.frozen_step
    fault, place, _ = cables.found_after(2 * SETTINGS.frozen_ticks)
    assert (fault, place) == (
        (Fault.CELL_FROZEN, 2) if mode is StopMode.DESCENT else (Fault.NONE, -1)
    )


HELD = np.arange(CABLES) == 5
WOUND = SETTINGS.frozen_travel / RADIUS
"""rad that the drum of a failed drive turns before its cell's reading has to have moved"""


def unwound(
    cables: Watched,
    angle: float,
    *,
    pull: float = PULL,
    swing: float = 0.0,
    held: Array = HELD,
    age: int = 0,
    ticks: int = 100,
) -> tuple[Fault, int]:
    """A drum that turns steadily by ``angle`` rad, under a reading that swings by some N."""
    noise = np.random.default_rng(1)
    cables.mode = StopMode.DESCENT
    ages = np.full(CABLES, age, np.uint16)
    for tick in range(ticks + 1):
        raw = noise.normal(pull + swing * (tick % 2), NOISE, CABLES)
        angles = np.where(HELD, angle * tick / ticks, 0.0)
        cables.isolation.unwound(raw, ages, np.full(CABLES, pull), angles, held)
    return cables.isolation.disobedient(cables.mode, held)


def test_a_drum_whose_drive_has_failed_does_not_pay_out_at_one_force(cables: Watched) -> None:
    """Either way round. Its cell is frozen, though its cable is given up already."""
    assert unwound(cables, 0.95 * WOUND) == (Fault.NONE, -1)
    cables.isolation.reset()
    assert unwound(cables, 1.05 * WOUND) == (Fault.CELL_FROZEN, 5)
    assert cables.isolation.disobedient(StopMode.PASSIVE, HELD) == (Fault.NONE, -1)
    cables.isolation.reset()
    assert cables.isolation.disobedient(cables.mode, HELD) == (Fault.NONE, -1)
    assert unwound(cables, -1.05 * WOUND) == (Fault.CELL_FROZEN, 5)
    assert unwound(cables, -1.05 * WOUND, held=~ALL) == (Fault.NONE, -1), "it has its name"


@pytest.mark.parametrize(
    "given",
    [
        {"swing": 1.5 * SETTINGS.frozen_band},
        {"pull": 0.95 * SETTINGS.torque_error},
        {"held": ~ALL},
        {"age": 1},
    ],
    ids=["it moves", "friction may be as much", "its drive is sound", "nothing fresh"],
)
def test_what_a_drum_may_well_do(cables: Watched, given: dict[str, Any]) -> None:
    assert unwound(cables, 5.0 * WOUND, **given) == (Fault.NONE, -1)


def test_a_reading_of_before_a_reset_says_nothing_of_a_drum(cables: Watched) -> None:
    assert unwound(cables, 0.95 * WOUND) == (Fault.NONE, -1)
    cables.isolation.reset()
    held, ages = HELD, np.zeros(CABLES, np.uint16)
    raw, angle = np.full(CABLES, PULL), np.full(CABLES, 3.0 * WOUND)
    cables.isolation.unwound(raw, ages, raw, angle, held)
    assert cables.isolation.disobedient(StopMode.DESCENT, held) == (Fault.NONE, -1)


def test_a_force_that_moves_with_its_reference_is_not_frozen(cables: Watched) -> None:
    cables.mode = StopMode.DESCENT
    cables.given["reference"][2] += 0.8 * SETTINGS.frozen_step
    assert cables.tick(200) == (Fault.NONE, -1)


def test_a_cell_without_load_may_repeat_itself(cables: Watched) -> None:
    for name in ("tension", "reference", "torque"):
        cables.given[name][2] = 0.0
    cables.repeats = 2
    assert cables.tick(200)[0] is not Fault.CELL_FROZEN


@pytest.mark.parametrize("name", ["innovation", "reference", "torque"])
def test_a_cable_that_is_not_watched_shows_nothing(cables: Watched, name: str) -> None:
    cables.watched[3] = False
    cables.given[name][3] += 1e3
    assert cables.tick(500) == (Fault.NONE, -1)


def test_a_reset_forgets_everything() -> None:
    def told(cables: Watched) -> list[Any]:
        cables.isolation.reset()
        return [cables.tick() for _ in range(30)]

    before = Watched()
    for name in ("innovation", "reference", "torque"):
        before.given[name] = before.given[name] + 1e3
    before.given["rate"][:] = 30.0
    before.tick(300)
    before.given = Watched().given
    assert told(before) == told(Watched())


@pytest.mark.parametrize("mode", StopMode)
def test_a_drum_speeds_up_no_faster_than_a_motor_can(cables: Watched, mode: StopMode) -> None:
    """An encoder that slips by a quarter of a turn in 30 ms; torque and tension say nothing."""
    cables.mode = mode
    cables.given["rate"][4] = 0.5 * np.pi / 0.03
    assert cables.tick() == (Fault.DRUM_TORQUE, 4)


def test_a_motor_at_its_limit_makes_no_such_step(cables: Watched) -> None:
    motor, drum = CONFIG.robot.motor, CONFIG.robot.drum
    torque = motor.current_limit * motor.torque_constant * CONFIG.robot.gearbox.ratio
    cables.given["torque"][4] = torque + RADIUS * PULL
    for _ in range(20):
        assert cables.tick() == (Fault.NONE, -1)
        cables.given["rate"][4] += PERIOD * torque / drum.inertia
