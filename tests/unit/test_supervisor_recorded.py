"""The supervisor where drives are not on CAN: it judges what the daemon records of them, and holds
the relay of the STO inputs. STO-1 to STO-3."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Any

import can
import numpy as np
import pytest

from tonus.config import Config, load
from tonus.config.schema.axis import Brake
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.signals import cycle_dtype
from tonus.runtime.states import State
from tonus.runtime.supervisor.record import CONTROLLED, Claim, New, claims
from tonus.runtime.supervisor.recorded import RecordedWiring, Replayed
from tonus.runtime.supervisor.supervisor import Supervisor
from tonus.runtime.supervisor.wiring import Wiring

MS = 1_000_000
ENABLED, AT_A_LIMIT, DISABLED, QUICK_STOP = 0x0237, 0x0A37, 0x0240, 0x0217
NODE = 120
BEAT = (0x77E, b"\5")
HELD, RELEASED = (0x200 + NODE, b"\1"), (0x200 + NODE, b"\0")
ROBOT: dict[str, Any] = {
    "supervisor.policy": "use",
    "supervisor.period_ms": 2,
    "supervisor.timeout_ms": 22,
    "supervisor.patience_ms": 5,
    "sto_relay.timeout_ms": 7,
}
Change = Callable[[Any], None]


class FakeBus:
    """Of the relay's channel."""

    def __init__(self) -> None:
        self.waiting: list[can.Message] = []
        self.sent: list[tuple[int, bytes]] = []
        self.broken = self.echoes = False

    def recv(self, timeout: float | None = None) -> can.Message | None:
        assert timeout == 0
        return self.waiting.pop(0) if self.waiting else None

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        del timeout
        if self.broken:
            raise can.CanError("gone")
        assert not message.is_extended_id
        self.sent.append((message.arbitration_id, bytes(message.data)))
        if self.echoes:
            self.waiting.append(message)

    def shutdown(self) -> None:
        """Nothing is held."""


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/ethercat.yaml", overrides=ROBOT)[0]


def _record(cables: int, now_ms: int) -> Any:
    """A robot that is held still, in order."""
    record = np.zeros(1, cycle_dtype(cables))[0]
    record["timing"]["tick"] = now_ms
    record["state"]["state"] = State.HOLD
    record["stiffness"]["k_eq"] = 3000.0
    drives, cells = record["drives"], record["force_cells"]
    drives["statusword"] = ENABLED
    cells["raw"][:-1] = record["tension"]["measured"] = record["tension"]["reference"] = 50.0
    # So that its torques are not equal to the last bit.
    drives["torque_command"] = drives["torque"] = 1.0 + 0.01 * (now_ms % 5)
    return record


class Held:
    """A supervisor, its relay's bus, and what a daemon records each ms; ``change`` is applied."""

    def __init__(self, config: Config) -> None:
        self.bus, self.config = FakeBus(), config
        self.answers = True
        self.recorded = True
        self.waiting: list[tuple[int, Any]] = []
        self.supervisor = Supervisor(config, self._new, lambda *_: self.bus)  # type: ignore[arg-type, return-value]
        self._now = 0

    def _new(self) -> New:
        new, self.waiting = self.waiting, []
        records = np.array([record for _, record in new], cycle_dtype(self.config.robot.cables))
        return [stamp for stamp, _ in new], records

    def step(self, change: Change = lambda _: None) -> list[tuple[int, bytes]]:
        """Two ms later: what it sends."""
        for _ in range(2):
            self._now += 1
            record = _record(self.config.robot.cables, self._now)
            change(record)
            if self.recorded:
                self.waiting.append((self._now * MS, record))
        if self.answers:
            beat = can.Message(arbitration_id=0x700 + NODE, is_extended_id=False, data=b"\5")
            self.bus.waiting.append(beat)
        return self.look()

    def look(self, later_ns: int = 0) -> list[tuple[int, bytes]]:
        """So long after the newest record: what it sends."""
        self.bus.sent = []
        self.supervisor.step(self._now * MS + later_ns)
        return self.bus.sent

    def steps(self, count: int, change: Change = lambda _: None) -> Iterator[list[Any]]:
        for _ in range(count):
            yield self.step(change)

    def armed(self) -> Held:
        """It holds the relay, and the robot is controlled."""
        list(self.steps(160, disarmed))
        assert self.step() == [BEAT, HELD]
        assert all(sent == [BEAT, HELD] for sent in self.steps(20))
        return self

    def stopped_for(self, change: Change, within: int = 10) -> Requirement:
        """What a change makes of it: an emergency, and the output off in the same look."""
        for sent in self.steps(within, change):
            if sent != [BEAT, HELD]:
                break
        identifier, data = sent[0]
        code, register, _, _ = struct.unpack("<HBBf", data)
        assert (identifier, register) == (0x0FE, 0x81)
        assert sent[1:] == [RELEASED]
        assert not self.supervisor.beating
        assert all(sent == [] for sent in self.steps(5, change))
        return Requirement(code - 0xFF00)


@pytest.fixture
def held(config: Config) -> Iterator[Held]:
    made = Held(config)
    yield made
    made.supervisor.close()


def disarmed(record: Any) -> None:
    record["state"]["state"] = State.STANDBY
    record["drives"]["statusword"] = DISABLED
    record["drives"]["torque_command"] = record["drives"]["torque"] = 0.0


# --- the relay -----------------------------------------------------------------------------------


def test_the_relay_is_held_when_nothing_was_enabled_for_a_while(held: Held) -> None:
    assert all(sent == [] for sent in held.steps(150, disarmed))
    assert held.step(disarmed) == [BEAT, HELD]
    assert held.step() == [BEAT, HELD]


def test_a_supervisor_that_finds_the_robot_armed_holds_nothing(held: Held) -> None:
    assert all(sent == [] for sent in held.steps(400))


def test_a_relay_that_does_not_answer_is_not_held(held: Held) -> None:
    held.answers = False
    assert all(sent == [] for sent in held.steps(400, disarmed))
    held.answers = True
    assert held.step(disarmed) == [BEAT, HELD]
    held.answers = False
    sent = list(held.steps(200, disarmed))
    assert sent[148] == [BEAT, HELD], "one that is late is no cause"
    assert RELEASED in sent[150]
    assert sent[151:] == [[]] * 49


def test_a_relay_that_answered_a_moment_ago_is_held(held: Held) -> None:
    list(held.steps(150, disarmed))
    held.answers = False
    assert held.step(disarmed) == [BEAT, HELD]


def test_without_a_record_it_holds_nothing(held: Held) -> None:
    held.recorded = False
    assert all(sent == [] for sent in held.steps(400))


def test_a_record_that_ends_while_nothing_is_enabled_releases_the_relay(held: Held) -> None:
    """It would not see that a drive is enabled. Nobody is told of a violation."""
    list(held.steps(160, disarmed))
    held.recorded = False
    assert held.step(disarmed) == [BEAT, HELD]
    assert held.step(disarmed) == [BEAT, HELD]
    assert held.step(disarmed) == [RELEASED]
    assert all(sent == [] for sent in held.steps(400, disarmed))
    assert held.supervisor.violation is None
    held.recorded = True
    assert held.step(disarmed) == [BEAT, HELD]


def test_a_record_may_be_as_old_as_the_patience_while_nothing_is_enabled(held: Held) -> None:
    list(held.steps(160, disarmed))
    assert held.look(5 * MS) == [BEAT, HELD]
    assert held.look(5 * MS + 1) == [RELEASED]


def test_a_record_that_ends_while_the_robot_is_armed_stops_it(held: Held) -> None:
    held.armed().recorded = False
    assert held.stopped_for(lambda _: None, within=3) == Requirement.TICK


def test_it_holds_the_relay_again_only_when_nothing_was_enabled_for_a_while(held: Held) -> None:
    held.armed()
    held.stopped_for(out_of_bounds)
    assert all(sent == [] for sent in held.steps(400)), "while a drive is enabled"
    assert all(sent == [] for sent in held.steps(150, disarmed))
    assert held.step(disarmed) == [BEAT, HELD]


def test_a_bus_of_the_relay_that_is_gone_raises_nothing(held: Held) -> None:
    held.armed().bus.broken = True
    assert held.step() == []
    held.bus.broken = False
    assert held.step() == [BEAT, HELD]


# --- what the record shows -----------------------------------------------------------------------


def out_of_bounds(record: Any) -> None:
    record["stiffness"]["k_eq"] = 1e5


def tense(record: Any) -> None:
    record["force_cells"]["raw"][3] = record["tension"]["measured"][3] = 230.0
    record["tension"]["reference"][3] = 230.0
    record["drives"]["torque_command"][3] = record["drives"]["torque"][3] = 4.6


def pushed(record: Any) -> None:
    record["force_cells"]["raw"][-1] = record["force_cells"]["filtered"][-1] = 28.0


def opposite(record: Any) -> None:
    record["drives"]["torque"][2] *= -1.0


def late(record: Any) -> None:
    record["drives"]["age"][5] = 40


def unmeasured(record: Any) -> None:
    record["force_cells"]["age"][1] = 40


def said_disarmed(record: Any) -> None:
    record["state"]["state"] = State.STANDBY


def infinite(record: Any) -> None:
    record["force_cells"]["raw"][4] = np.inf


@pytest.mark.parametrize(
    ("change", "requirement", "within"),
    [
        (out_of_bounds, Requirement.STIFFNESS, 2),
        (tense, Requirement.TENSION, 10),
        (pushed, Requirement.CONTACT, 10),
        (opposite, Requirement.COMMAND_LOGGED, 10),
        (late, Requirement.STALE, 20),
        (unmeasured, Requirement.STALE, 20),
        (said_disarmed, Requirement.DISARMED, 40),
        (infinite, Requirement.TENSION, 10),
    ],
)
def test_what_the_record_shows(
    held: Held, change: Change, requirement: Requirement, within: int
) -> None:
    assert held.armed().stopped_for(change, within) == requirement


def test_recorded_torques_that_stay_while_the_tensions_change(held: Held) -> None:
    held.armed()
    count = 0

    def frozen(record: Any) -> None:
        nonlocal count
        count += 1
        record["drives"]["torque_command"] = record["drives"]["torque"] = 1.01
        record["force_cells"]["raw"][:-1] = 50.0 + 0.02 * count
        record["tension"]["measured"] = record["tension"]["reference"] = 50.0 + 0.02 * count

    assert held.stopped_for(frozen) == Requirement.FROZEN


def test_drums_that_turn_faster_than_the_platform_may(held: Held) -> None:
    """In a stop, by the wide bound: the platform moves upwards with 3 m/s."""
    geometry = held.config.robot.geometry
    along = np.array(geometry.frame) - np.array(geometry.platform)
    upwards = along[:, 2] / np.linalg.norm(along, axis=1)
    count = 0

    def rising(record: Any) -> None:
        nonlocal count
        count += 1
        record["state"]["state"] = State.SAFE_STOP
        record["drives"]["angle"] = 3.0e-3 * count * upwards / 0.02

    held.armed()
    assert held.stopped_for(rising, within=70) == Requirement.SPEED


def test_a_drive_in_quick_stop_is_enabled_by_its_recorded_statusword(held: Held) -> None:
    def quick_stop(record: Any) -> None:
        disarmed(record)
        record["drives"]["statusword"][1] = QUICK_STOP

    assert all(sent == [] for sent in held.steps(400, quick_stop))


def test_a_cell_that_reports_a_defect_says_nothing_in_a_stop(held: Held) -> None:
    def broken(record: Any) -> None:
        record["state"]["state"] = State.SAFE_STOP
        record["force_cells"]["raw"][3] = 500.0
        record["force_cells"]["status"][3] = 3

    held.armed()
    assert all(sent == [BEAT, HELD] for sent in held.steps(100, broken))


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
        record = _record(self.cables, 0)
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
    player.replayed.take(claims(([MS], np.array([_record(player.cables, 0)]))))
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


# --- a record that cannot be right ---------------------------------------------------------------


def test_a_controlled_robot_without_drives_releases_the_relay(held: Held) -> None:
    """Whatever statuswords are recorded: it may be that only they are wrong."""

    def undriven(record: Any) -> None:
        record["drives"]["statusword"] = DISABLED

    list(held.steps(160, disarmed))
    assert all(sent == [BEAT, HELD] for sent in held.steps(25, undriven))
    assert held.look(1) == [RELEASED]
    assert all(sent == [] for sent in held.steps(400, undriven))
    assert list(held.steps(2, disarmed))[-1] == [BEAT, HELD]
    assert all(sent == [BEAT, HELD] for sent in held.steps(100))
    assert all(sent == [BEAT, HELD] for sent in held.steps(24, undriven))
    assert [RELEASED] in list(held.steps(3, undriven))


@pytest.mark.parametrize("state", State)
@pytest.mark.parametrize("torque", [0.0, 0.1])
def test_drives_that_take_long_to_be_enabled(held: Held, state: State, torque: float) -> None:
    """The daemon waits for them while it is referencing, and sends no torque until they are."""

    def waiting(record: Any) -> None:
        disarmed(record)
        record["state"]["state"] = state
        record["drives"]["torque_command"][3] = torque

    list(held.steps(160, disarmed))
    sent = list(held.steps(400, waiting))
    waits = state not in CONTROLLED or (state is State.REFERENCING and torque == 0.0)
    assert (sent == [[BEAT, HELD]] * 400) is waits
    assert waits or sent[:25] == [[BEAT, HELD]] * 25
    assert waits or sent[27:] == [[]] * 373


def test_a_controlled_robot_without_drives_from_the_first_record_on(held: Held) -> None:
    def undriven(record: Any) -> None:
        record["drives"]["statusword"] = DISABLED

    assert all(sent == [] for sent in held.steps(400, undriven))


def test_drives_that_all_stop_answering_while_nothing_is_enabled_release_the_relay(
    held: Held,
) -> None:
    count = 0

    def deaf(record: Any) -> None:
        nonlocal count
        count += 1
        disarmed(record)
        record["drives"]["age"] = count

    def one_deaf(record: Any) -> None:
        deaf(record)
        record["drives"]["age"][3] = 0

    list(held.steps(160, disarmed))
    assert all(sent == [BEAT, HELD] for sent in held.steps(200, one_deaf))
    list(held.steps(1, disarmed))
    count = 0
    assert all(sent == [BEAT, HELD] for sent in held.steps(150, deaf))
    assert held.look(1) == [RELEASED]
    assert list(held.steps(1, disarmed)) == [[BEAT, HELD]]


@pytest.mark.parametrize("quiet_s", [0.3, 2.0])
def test_a_stop_in_which_no_drive_answers_is_let_be_for_a_while(quiet_s: float) -> None:
    """They are sent no torque, and would have none without the relay either: then nothing speaks
    for it any more. It is no mistake of the daemon."""
    held = Held(load("config/ethercat.yaml", overrides={**ROBOT, "supervisor.quiet_s": quiet_s})[0])
    count = 0

    def silent(record: Any) -> None:
        nonlocal count
        count += 1
        record["state"]["state"] = State.SAFE_STOP
        record["drives"]["age"] = count
        record["drives"]["torque_command"] = 0.0

    list(held.steps(round(quiet_s * 500.0), disarmed))
    held.armed()
    assert all(sent == [BEAT, HELD] for sent in held.steps(round(quiet_s * 500.0), silent))
    assert held.step(silent) == [RELEASED]
    assert held.supervisor.violation is None
    assert all(sent == [] for sent in held.steps(100, silent))
    held.supervisor.close()


def test_a_record_that_ends_after_one_drive_has_been_silent_for_long(held: Held) -> None:
    """The others answer: that it ends is the daemon's mistake, and told."""
    count = 0

    def silent(record: Any) -> None:
        nonlocal count
        count += 1
        record["state"]["state"] = State.SAFE_STOP
        record["drives"]["age"][3] = count
        record["drives"]["torque_command"][3] = 0.0

    held.armed()
    assert all(sent == [BEAT, HELD] for sent in held.steps(200, silent))
    held.recorded = False
    assert held.stopped_for(silent) is Requirement.TICK


def test_a_silent_drive_of_which_no_heartbeat_is_read_is_off(held: Held) -> None:
    """Once the daemon and all others are disarmed: it was pulled, or has no power."""
    count = 0

    def pulled(record: Any) -> None:
        nonlocal count
        count += 1
        disarmed(record)
        record["state"]["state"] = State.FAULT
        record["drives"]["age"][1] = count
        record["drives"]["statusword"][1] = ENABLED

    held.armed()
    assert all(sent == [BEAT, HELD] for sent in held.steps(100, pulled))


def test_the_same_record_again_is_none(held: Held) -> None:
    def again(record: Any) -> None:
        record["timing"]["tick"] = 362

    assert held.armed().stopped_for(again) == Requirement.TICK


def test_a_record_of_the_future_is_none(held: Held) -> None:
    """Else all that is recorded after it would be older than what was measured last."""

    def wild(record: Any) -> None:
        record["stiffness"]["k_eq"] = 1e6

    list(held.steps(160, disarmed))
    record = _record(held.config.robot.cables, 0)
    disarmed(record)
    record["timing"]["tick"] = 10**6
    held.waiting.append((10**6 * MS, record))
    assert held.step(disarmed) == [BEAT, HELD]
    assert held.stopped_for(wild, within=1) == Requirement.STIFFNESS


@pytest.mark.parametrize(("ahead_ms", "taken"), [(1, True), (2, False)])
def test_how_far_ahead_a_record_may_be(held: Held, ahead_ms: int, taken: bool) -> None:
    held.armed()
    record = _record(held.config.robot.cables, 0)
    record["stiffness"]["k_eq"] = 1e6
    record["timing"]["tick"] = 10**6
    held.recorded = False
    held.waiting.append(((364 + ahead_ms) * MS, record))
    assert (held.step() != [BEAT, HELD]) is taken


def test_a_record_that_ends_with_one_of_the_future_releases_the_relay(held: Held) -> None:
    list(held.steps(160, disarmed))
    held.recorded = False
    record = _record(held.config.robot.cables, 0)
    disarmed(record)
    record["timing"]["tick"] = 10**6
    held.waiting.append((10**6 * MS, record))
    assert [RELEASED] in list(held.steps(4, disarmed))


def no_torque_told(record: Any) -> None:
    record["drives"]["torque"][3] = np.nan


def no_angle(record: Any) -> None:
    record["drives"]["angle"][3] = np.nan


def no_command(record: Any) -> None:
    record["drives"]["torque_command"][3] = np.inf


@pytest.mark.parametrize("change", [no_torque_told, no_angle, no_command])
def test_what_is_no_number_is_beyond_every_bound(held: Held, change: Change) -> None:
    held.armed()
    assert all(sent == [BEAT, HELD] for sent in held.steps(20))
    assert held.stopped_for(change, within=4) == Requirement.COMMAND_LOGGED


def test_a_silent_drive_may_have_been_measured_never(held: Held) -> None:
    def unknown(record: Any) -> None:
        disarmed(record)
        record["drives"]["angle"][3] = record["drives"]["torque"][3] = np.nan
        record["drives"]["age"][3] = 0xFFFF

    assert all(sent == [] for sent in held.steps(400, unknown)), "not all of it arrives"


@pytest.mark.parametrize(
    ("identifier", "data"),
    [
        (0x600 + NODE, b"\x2b\x16\x10\1\0\0\0\0"),
        (0x600 + NODE, b"\x0d\0\0\0\0\0\0\0"),
        (0x000, b"\x80" + bytes([NODE])),
        (0x200 + NODE, b"\1"),
        (0x200 + NODE, b"\1\0"),
        (0x77E, b"\5"),
    ],
)
def test_what_another_sends_to_the_node_of_the_relay(
    held: Held, identifier: int, data: bytes
) -> None:
    """Its settings, its state, its output, or the heartbeat that it waits for. The bus of this test
    tells nothing of what was sent, so as many of a stranger's have to come."""
    held.armed()
    again = 1 if identifier in (0x000, 0x600 + NODE) else 200
    for _ in range(again):
        message = can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
        held.bus.waiting.append(message)
    assert held.stopped_for(lambda _: None, within=1) == Requirement.COMMANDED


@pytest.mark.parametrize("frame", [BEAT, HELD])
def test_its_own_frames_that_come_back_are_no_strangers(
    held: Held, frame: tuple[int, bytes]
) -> None:
    """More than a bus may repeat are."""
    held.bus.echoes = True
    identifier, data = frame
    message = can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
    held.armed().bus.waiting += [message] * 16
    assert held.step() == [BEAT, HELD]
    held.bus.waiting.append(message)
    assert held.stopped_for(lambda _: None, within=1) == Requirement.COMMANDED


def test_a_frame_without_the_output_sets_none(held: Held) -> None:
    empty = can.Message(arbitration_id=0x200 + NODE, is_extended_id=False)
    held.armed().bus.waiting += [empty] * 200
    assert held.step() == [BEAT, HELD]
