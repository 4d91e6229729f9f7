"""What the supervisor makes of records where no drive is on CAN: the drives' own torques, and what
would be in their frames. STO-1."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.unit.recorded_setup import (
    AT_A_LIMIT,
    DISABLED,
    ENABLED,
    MS,
    ROBOT,
    Change,
    record_of,
)
from tonus.config import Config, load
from tonus.config.schema.axis import Brake
from tonus.runtime.supervisor.record import Claim, claims
from tonus.runtime.supervisor.recorded import RecordedWiring, Replayed
from tonus.runtime.supervisor.wiring import Wiring


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/ethercat.yaml", overrides=ROBOT)[0]


# --- the drives' own torque ----------------------------------------------------------------------


class Player:
    """Records, each a tick after the one before, and what is made of them."""

    def __init__(self, config: Config, tick_ns: int = MS) -> None:
        self.cables, self.tick_ns = config.robot.cables, tick_ns
        self.wiring = RecordedWiring(config, config.relay)  # type: ignore[arg-type]
        self.replayed = Replayed(config, self.wiring)
        self.now = 0

    def claim(self, change: Change) -> Claim:
        self.now += 1
        record = record_of(self.cables, 0)
        record["timing"]["tick"] = self.now
        change(record)
        return claims(([self.now * self.tick_ns], np.array([record])), answered=True)[0]

    def take(self, *changes: Change) -> None:
        self.replayed.take([self.claim(change) for change in changes])


def commanded(value: float, answered: float, word: int = ENABLED) -> Change:
    def change(record: Any) -> None:
        record["drives"]["torque_command"] = value
        record["drives"]["torque"] = answered
        record["drives"]["statusword"] = word

    return change


@pytest.fixture
def player(config: Config) -> Player:
    made = Player(config)
    for value in (1.0, 1.2, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0):
        made.take(commanded(value, 1.0))
    return made


@pytest.mark.parametrize(
    ("answered", "word", "newton"),
    [
        (1.0, ENABLED, 0.0),
        (1.2, ENABLED, 0.0),
        (1.3, ENABLED, 0.1 / 0.02),
        (0.8, ENABLED, 0.2 / 0.02),
        (-1.0, ENABLED, 2.0 / 0.02),
        (1.3, AT_A_LIMIT, 0.1 / 0.02),
        (0.0, AT_A_LIMIT, 0.0),
        (-1.0, AT_A_LIMIT, 1.0 / 0.02),
        (-1.0, DISABLED, 0.0),
    ],
)
def test_how_far_a_drives_torque_is_from_what_it_was_sent(
    player: Player, answered: float, word: int, newton: float
) -> None:
    player.take(commanded(1.0, answered, word))
    assert player.replayed.astray == pytest.approx(np.full(player.cables, newton))


@pytest.mark.parametrize(("answered", "newton"), [(-0.4, 0.0), (0.0, 0.0), (0.4, 0.4 / 0.02)])
def test_a_limit_of_a_drive_that_was_sent_to_pay_out(
    player: Player, answered: float, newton: float
) -> None:
    for _ in range(8):
        player.take(commanded(-1.0, -1.0))
    player.take(commanded(-1.0, answered, AT_A_LIMIT))
    assert player.replayed.astray == pytest.approx(np.full(player.cables, newton))


def test_the_farthest_of_the_new_records_counts_and_older_ones_no_more(player: Player) -> None:
    right, wrong = commanded(1.0, 1.0), commanded(1.0, 0.5)
    player.take(right, wrong, right)
    assert player.replayed.astray == pytest.approx(np.full(player.cables, 25.0))
    player.take()
    assert player.replayed.astray.max() > 0.0, "without a new record the last one holds"
    player.take(right)
    assert player.replayed.astray.max() == 0.0


def silent(value: float, answered: float, *axes: int) -> Change:
    """The record of a tick in which these axes were not sampled, and has their last answers."""

    def change(record: Any) -> None:
        commanded(value, answered)(record)
        record["drives"]["age"][list(axes)] = 3

    return change


def test_a_drive_that_answers_seldom_has_the_torque_that_it_answered_last(player: Player) -> None:
    """Until it answers anew, or that it has no power."""
    right, wrong = commanded(1.0, 1.0), commanded(1.0, 0.5)
    player.take(wrong)
    player.take(silent(1.0, 0.5, 2, 5))
    assert player.replayed.astray == pytest.approx(np.full(player.cables, 25.0))
    player.take(silent(1.0, 1.0, 2, 5))
    expected = np.where(np.isin(np.arange(player.cables), (2, 5)), 25.0, 0.0)
    assert player.replayed.astray == pytest.approx(expected)
    player.take(right)
    assert player.replayed.astray.max() == 0.0
    player.take(wrong)
    player.take(commanded(1.0, 0.5, DISABLED))
    assert player.replayed.astray.max() == 0.0
    player.take(commanded(1.4, 1.0))
    player.take(wrong)
    assert player.replayed.astray.min() > 0.0
    player.take(commanded(1.0, 1.2))
    assert player.replayed.astray.max() == 0.0, "between the least and the largest"


@pytest.mark.parametrize(("answered", "newton"), [(1.3, 5.0), (-0.1, 5.0), (0.0, 0.0)])
def test_a_command_that_is_no_number_explains_no_torque_but_none(
    player: Player, answered: float, newton: float
) -> None:
    player.take(commanded(np.nan, 1.0))
    assert (player.replayed.astray == np.inf).all()
    player.take(commanded(1.0, answered))
    assert player.replayed.astray == pytest.approx(np.full(player.cables, newton))


def test_a_torque_that_was_sent_long_ago_explains_nothing(player: Player) -> None:
    player.take(commanded(1.0, 1.0), commanded(1.0, 1.0), commanded(1.0, 1.2))
    assert player.replayed.astray == pytest.approx(np.full(player.cables, 10.0))


@pytest.mark.parametrize("value", [20.0, 1e10, 1e300])
def test_a_torque_beyond_the_motors_limit_counts_as_it_is_sent(
    player: Player, value: float
) -> None:
    """However large it is recorded, and by which it explains no more than the limit."""
    axis = player.wiring.axes[2]
    assert axis.newton is not None
    assert axis.per_newton_metre is not None
    most = axis.limit / abs(axis.per_newton_metre)
    for sign in (1.0, -1.0):
        player.take(commanded(sign * value, 1.0))
        word = player.replayed.heard["", axis.sent].word
        force = axis.torque.number(word) * axis.newton
        assert force == pytest.approx(sign * most / 0.02, abs=abs(axis.newton))
        player.take(commanded(sign * 1.0, sign * (most + 0.2)))
        assert player.replayed.astray[2] == pytest.approx(10.0)


def test_while_its_brake_opens_a_drive_holds_the_motor_by_itself(config: Config) -> None:
    """For as long as that takes, and a torque takes to come back, each time that it is enabled."""
    brake = Brake(torque=0.4, opening_ms=40.0, closing_ms=20.0)
    robot = config.robot.model_copy(update={"brake": brake})
    player = Player(config.model_copy(update={"robot": robot}))
    holding = 46
    for _ in range(2):
        player.take(*[commanded(0.0, 0.0, DISABLED)] * 20)
        for _ in range(holding):
            player.take(commanded(0.0, 1.0))
            assert player.replayed.astray.max() == 0.0
        player.take(commanded(0.0, 1.0))
        assert player.replayed.astray == pytest.approx(np.full(player.cables, 50.0))


@pytest.mark.parametrize(("disabled", "excused"), [(1, False), (19, False), (20, True)])
def test_a_brake_that_had_no_time_to_close_does_not_open(
    config: Config, disabled: int, excused: bool
) -> None:
    """One record of *switched on* now and then would excuse the drive's own torque for ever."""
    brake = Brake(torque=0.4, opening_ms=40.0, closing_ms=20.0)
    robot = config.robot.model_copy(update={"brake": brake})
    player = Player(config.model_copy(update={"robot": robot}))
    player.take(*[commanded(0.0, 0.0, DISABLED)] * 20)
    player.take(*[commanded(0.0, 0.0)] * 60)
    player.take(*[commanded(0.0, 0.0, DISABLED)] * disabled)
    player.take(commanded(0.0, 1.0))
    assert bool(player.replayed.astray.max() == 0.0) is excused


def test_what_is_in_no_frame_has_no_identifier(config: Config) -> None:
    assert config.relay is not None
    for axis in RecordedWiring(config, config.relay).axes:
        assert (axis.heartbeat, axis.sync, axis.request) == (0, 0, 0)


def test_a_motor_without_a_brake_is_compared_from_the_first_enabled_tick_on(player: Player) -> None:
    player.take(*[commanded(0.0, 0.0, DISABLED)] * 20)
    player.take(commanded(0.0, 1.0))
    assert player.replayed.astray == pytest.approx(np.full(player.cables, 50.0))


def test_a_drive_that_is_silent_is_not_compared(player: Player) -> None:
    """Its last torque stays in the record, while it is sent none any more."""

    def silent(record: Any) -> None:
        commanded(0.0, 1.0)(record)
        record["drives"]["age"][:4] = 20

    player.take(*[silent] * 12)
    assert player.replayed.astray[:4].max() == 0.0
    assert player.replayed.astray[4:] == pytest.approx(np.full(player.cables - 4, 50.0))


def test_before_enough_was_recorded_nothing_is_compared(config: Config) -> None:
    new = Player(config)
    for _ in range(8):
        new.take(commanded(1.0, -1.0))
        assert new.replayed.astray.max() == 0.0
    new.take(commanded(1.0, -1.0))
    assert new.replayed.astray.max() > 0.0


# --- records as frames ---------------------------------------------------------------------------


@pytest.mark.parametrize("moved_ns", [-40, 0, 1, 40])
def test_a_measurement_that_is_repeated_is_no_new_one(config: Config, moved_ns: int) -> None:
    """Also where a distributed clock moves every tick."""
    player = Player(config, MS + moved_ns)

    def aged(age: int) -> Change:
        def change(record: Any) -> None:
            record["drives"]["age"] = record["force_cells"]["age"] = age

        return change

    axis, cell = player.wiring.axes[3], player.wiring.cells[3]
    heard = player.replayed.heard
    player.take(aged(0xFFFF))
    assert heard["", axis.received].count == heard["", cell.received].count == 0
    assert heard["", axis.sent].count == 1
    player.take(aged(1), aged(2), aged(3))
    assert heard["", axis.received].count == heard["", cell.received].count == 1
    assert heard["", axis.received].at_ns == 2 * player.tick_ns
    player.take(aged(1))
    assert heard["", axis.received].count == heard["", cell.received].count == 2
    assert heard["", axis.sent].count == 5


def test_the_numbers_of_a_record_in_their_units(config: Config) -> None:
    player = Player(config)

    def change(record: Any) -> None:
        record["drives"]["torque_command"][2] = -1.5
        record["drives"]["angle"][2] = -0.25
        record["force_cells"]["raw"][2] = 47.25

    player.take(change)
    axis, cell, heard = player.wiring.axes[2], player.wiring.cells[2], player.replayed.heard
    assert axis.newton is not None
    assert axis.metre is not None
    torque = axis.torque.number(heard["", axis.sent].word) * axis.newton
    assert torque == pytest.approx(-1.5 / 0.02, abs=0.6 * abs(axis.newton))
    position = axis.position.number(heard["", axis.received].word) * axis.metre
    assert position == pytest.approx(-0.25 * 0.02, abs=1e-9)
    assert heard["", axis.received].word >> axis.statusword.shift & 0xFFFF == ENABLED
    assert cell.force.number(heard["", cell.received].word) == pytest.approx(47.25)


def test_a_force_beyond_what_a_frame_can_say_is_infinite(config: Config) -> None:
    player = Player(config)

    def change(record: Any) -> None:
        record["force_cells"]["raw"][2] = -1e300

    player.take(change)
    cell = player.wiring.cells[2]
    word = player.replayed.heard["", cell.received].word
    assert cell.force.number(word) == -np.inf


def test_a_claim_without_answers_shows_nothing(config: Config) -> None:
    player = Player(config)
    player.replayed.take(claims(([MS], np.array([record_of(player.cables, 0)]))))
    assert all(heard.count == 0 for heard in player.replayed.heard.values())


def test_an_axis_is_the_same_as_by_its_frames(config: Config) -> None:
    """Torque, mass and damping, against the same robot on CAN."""
    by_number = {axis.number: axis for axis in Wiring(load("config/can.yaml")[0]).axes}
    for axis in Player(config).wiring.axes:
        frames = by_number[axis.number]
        assert axis.newton == pytest.approx(frames.newton)
        assert axis.per_newton_metre == pytest.approx(frames.per_newton_metre)
        assert axis.mass == pytest.approx(frames.mass)
        assert axis.damping == pytest.approx(frames.damping)
