"""What nodes say of themselves, frame by frame: heartbeats, silence, restarts, emergencies."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from tonus.config import load
from tonus.config.schema.bus import CanopenBus
from tonus.config.timeouts import node_timeout_ms
from tonus.drivers.canopen.identifiers import EMCY, HEARTBEAT
from tonus.drivers.canopen.nmt import NmtState, NodeMonitor
from tonus.drivers.canopen.supervision import Supervision, Watched
from tonus.drivers.devices.drive_errors import Reset
from tonus.drivers.events import EventLog

CONFIG = load("config/can.yaml")[0]
assert isinstance(CONFIG.fieldbus, CanopenBus)
MASTER, DEVICE = CONFIG.fieldbus.master, CONFIG.fieldbus.drive
TOLERANCE = CONFIG.tolerance
PERIOD_US = 1000
ALLOWED = node_timeout_ms(DEVICE, MASTER, TOLERANCE)
"""ticks"""
OPERATIONAL, BOOT_UP, STOPPED = (
    bytes([state]) for state in (NmtState.OPERATIONAL, NmtState.BOOT_UP, NmtState.STOPPED)
)


class Errors:
    """0x7000 wants a communication reset, 0x8000 a device reset, all others a fault reset."""

    def reset(self, code: int) -> Reset:
        wanted = {0x7000: Reset.COMMUNICATION_RESET, 0x8000: Reset.DEVICE_RESET}
        return wanted.get(code, Reset.FAULT_RESET)

    def text(self, code: int) -> str:
        return f"meaning {code:X}"


class Robot:
    """A drive, axis 1, and an amplifier of two cells, 3 and 4; both are operational."""

    def __init__(self, period_us: int = PERIOD_US) -> None:
        self.exchange: Any = SimpleNamespace(
            untrusted=[0] * 4, error_codes=[0] * 4, cell_emergency=[0] * 6, cell_status=[0] * 6
        )
        self.events = EventLog()
        self.supervision = Supervision(self.exchange, self.events, MASTER, TOLERANCE, period_us)
        self.drive = self._watched("drive of axis 1", 2, axis=1)
        self.amplifier = self._watched("cells 3 and 4", 17, cells=(3, 4))
        for each in (self.drive, self.amplifier):
            self.supervision.add(each)
        for each in (self.drive, self.amplifier):
            self.hear(each, OPERATIONAL)
        self.events.take()
        self.supervision.begin(0)
        for each in (self.drive, self.amplifier):
            each.node.monitor.heard = False

    def _watched(self, title: str, node_id: int, **rows: Any) -> Watched:
        role = SimpleNamespace(title=title, device=DEVICE, errors=Errors())
        node: Any = SimpleNamespace(
            node_id=node_id,
            where=f"can1/{node_id}",
            role=role,
            monitor=NodeMonitor(),
            started=True,
            channel=SimpleNamespace(handlers={}),
        )
        return Watched(node, SimpleNamespace(silence=0), **rows)  # type: ignore[arg-type]

    def hear(self, watched: Watched, data: bytes) -> list[str]:
        watched.node.channel.handlers[HEARTBEAT + watched.node.node_id](data)
        return self.told()

    def emergency(self, watched: Watched, data: bytes) -> list[str]:
        watched.node.channel.handlers[EMCY + watched.node.node_id](data)
        return self.told()

    def told(self) -> list[str]:
        return [f"{event.name} {event.where}" for event in self.events.take()]

    def look(self, first: int, last: int, *, alive: Watched | None = None) -> list[str]:
        """Ticks, in which a node may go on to send heartbeats."""
        for tick in range(first, last + 1):
            if alive is not None:
                alive.node.monitor.heard = True
            self.supervision.look_for_silence(tick)
        return self.told()


@pytest.fixture
def robot() -> Robot:
    return Robot()


def test_a_node_is_trusted_while_it_is_operational_and_heard(robot: Robot) -> None:
    drive = robot.drive
    assert drive.trusted
    for name, bad in (("silent", True), ("restarted", True)):
        setattr(drive, name, bad)
        assert not drive.trusted
        setattr(drive, name, False)
    drive.node.started = False
    assert not drive.trusted
    drive.node.started = True
    drive.node.monitor.state = NmtState.STOPPED
    assert not drive.trusted


def test_silence_is_told_once_when_it_has_lasted_too_long(robot: Robot) -> None:
    """Of two nodes each is looked at in every second tick."""
    drive, other = robot.drive, robot.amplifier
    order = [robot.supervision.watched.index(each) for each in (drive, other)]
    assert order == [0, 1]
    last = ALLOWED if ALLOWED % 2 == 0 else ALLOWED - 1
    assert robot.look(1, last + 1, alive=other) == []
    assert not drive.silent
    assert robot.look(last + 2, last + 20, alive=other) == ["heartbeat_lost can1/2"]
    assert drive.silent
    assert robot.exchange.untrusted == [0, 1, 0, 0]
    assert robot.hear(drive, OPERATIONAL) == ["heartbeat_back can1/2"]
    assert not drive.silent
    assert robot.exchange.untrusted == [0, 0, 0, 0]
    heard_at = last + 22
    assert robot.look(last + 21, heard_at + ALLOWED - 1, alive=other) == []
    assert not drive.silent


def test_how_long_a_silence_may_be_to_the_microsecond() -> None:
    robot = Robot(period_us=1)
    for tick in (1000 * ALLOWED, 1000 * ALLOWED):
        robot.supervision.look_for_silence(tick)
    assert robot.told() == []
    for _ in range(2):
        robot.supervision.look_for_silence(1000 * ALLOWED + 1)
    assert sorted(robot.told()) == ["heartbeat_lost can1/17", "heartbeat_lost can1/2"]


def test_a_node_is_neither_silent_nor_restarted_at_first(robot: Robot) -> None:
    new = Watched(robot.drive.node, robot.drive.arrival)
    assert new.trusted


def test_a_node_that_is_restored_before_the_next_tick_is_heard_in_this_one(robot: Robot) -> None:
    robot.supervision.begin(500)
    robot.drive.heard_at = 3
    robot.supervision.restored(robot.drive)
    assert robot.drive.heard_at == 500


def test_a_heartbeat_counts_from_the_tick_in_which_it_is_seen(robot: Robot) -> None:
    robot.drive.node.monitor.heard = True
    robot.look(1, 2, alive=robot.amplifier)
    assert robot.drive.heard_at == 2
    assert not robot.drive.node.monitor.heard
    robot.supervision.begin(500)
    assert (robot.drive.heard_at, robot.amplifier.heard_at) == (500, 500)


def test_a_node_that_was_not_started_is_not_missed(robot: Robot) -> None:
    robot.drive.node.started = False
    assert robot.look(1, 3 * ALLOWED, alive=robot.amplifier) == []
    assert not robot.drive.silent
    assert robot.hear(robot.drive, BOOT_UP) == []
    assert not robot.drive.restarted


def test_a_silent_amplifier_makes_no_axis_untrusted(robot: Robot) -> None:
    found = robot.look(1, 3 * ALLOWED, alive=robot.drive)
    assert found == ["heartbeat_lost can1/17"]
    assert robot.exchange.untrusted == [0] * 4


def test_nobody_to_look_at() -> None:
    robot = Robot()
    robot.supervision.clear()
    assert robot.look(1, 3 * ALLOWED) == []


def test_a_node_without_answers_to_its_syncs_is_told_once_an_episode(robot: Robot) -> None:
    late = MASTER.late_ticks
    robot.drive.arrival.silence = late
    assert robot.look(1, 10, alive=robot.drive) == []
    for _ in range(2):
        robot.drive.arrival.silence = late + 1
        robot.drive.node.monitor.heard = robot.amplifier.node.monitor.heard = True
        found = []
        for tick in range(11, 19):
            robot.supervision.look_for_silence(tick)
            found += robot.told()
        assert found == ["silent_pdo can1/2"]
        robot.drive.arrival.silence = late
        robot.look(19, 20, alive=robot.drive)


def test_answers_of_a_node_that_is_not_trusted_are_not_missed(robot: Robot) -> None:
    robot.drive.arrival.silence = MASTER.late_ticks + 1
    robot.drive.restarted = True
    assert robot.look(1, 10, alive=robot.drive) == []


def test_a_restart_is_told_and_the_axis_is_not_trusted_until_it_is_restored(robot: Robot) -> None:
    drive = robot.drive
    robot.exchange.error_codes[1] = 0x7000
    assert robot.hear(drive, BOOT_UP) == ["boot_up can1/2"]
    assert drive.restarted
    assert robot.exchange.error_codes == [0] * 4
    assert robot.exchange.untrusted == [0, 1, 0, 0]
    assert robot.hear(drive, OPERATIONAL) == [], "operational, but without its configuration"
    assert robot.exchange.untrusted == [0, 1, 0, 0]
    drive.standing.add(Reset.DEVICE_RESET)
    drive.silent = True
    robot.look(1, 7)
    robot.supervision.restored(drive)
    assert (drive.restarted, drive.silent, drive.standing) == (False, False, set())
    assert drive.heard_at == 7
    assert robot.exchange.untrusted == [0] * 4


def test_a_restarted_amplifier_has_no_axis(robot: Robot) -> None:
    robot.exchange.error_codes[:] = [9] * 4
    assert robot.hear(robot.amplifier, BOOT_UP) == ["boot_up can1/17"]
    assert robot.exchange.error_codes == [9] * 4
    assert robot.exchange.untrusted == [0] * 4


def test_a_restored_amplifier_has_its_emergency_taken_back(robot: Robot) -> None:
    robot.emergency(robot.amplifier, b"\x10\x50\x81\0\0\0\0\0")
    robot.exchange.cell_status[:] = [7] * 6
    assert robot.exchange.cell_emergency == [0, 0, 0, 0x5010, 0x5010, 0]
    robot.look(1, 3 * ALLOWED, alive=robot.drive)
    robot.supervision.resetting(robot.amplifier)
    robot.supervision.restored(robot.amplifier)
    assert robot.exchange.cell_emergency == [0] * 6
    assert robot.exchange.cell_status == [7, 7, 7, 0, 0, 7]
    later = 3 * ALLOWED
    assert robot.look(later + 1, later + 3 * ALLOWED, alive=robot.drive) == [
        "heartbeat_lost can1/17"
    ], "another episode"


def test_a_node_that_leaves_operational_and_comes_back_is_told_each_time(robot: Robot) -> None:
    assert robot.hear(robot.drive, OPERATIONAL) == []
    assert robot.hear(robot.drive, STOPPED) == ["left_operational can1/2"]
    assert robot.exchange.untrusted == [0, 1, 0, 0]
    assert robot.hear(robot.drive, STOPPED) == [], "as before"
    assert robot.hear(robot.drive, OPERATIONAL) == ["operational_again can1/2"]
    assert robot.exchange.untrusted == [0] * 4


def test_a_heartbeat_that_says_nothing(robot: Robot) -> None:
    robot.drive.silent = True
    for data in (b"", b"\5\5", b"\x11"):
        assert robot.hear(robot.drive, data) == []
    assert robot.drive.silent


def test_an_emergency_reaches_the_axis_and_what_it_needs_is_kept(robot: Robot) -> None:
    drive = robot.drive
    assert robot.emergency(drive, b"\x20\x83\x11\0\0\0\0\0") == ["emcy can1/2"]
    assert robot.exchange.error_codes == [0, 0x8320, 0, 0]
    assert drive.standing == set()
    robot.emergency(drive, b"\x00\x70\x11\0\0\0\0\0")
    assert drive.standing == {Reset.COMMUNICATION_RESET}
    robot.emergency(drive, b"\x00\x80\x11\0\0\0\0\0")
    assert drive.standing == {Reset.COMMUNICATION_RESET, Reset.DEVICE_RESET}
    robot.emergency(drive, b"\x00\x00\x00\0\0\0\0\0")
    assert drive.standing == set()
    assert robot.exchange.error_codes == [0] * 4
    assert robot.exchange.cell_emergency == [0] * 6


def test_an_emergency_in_words(robot: Robot) -> None:
    robot.drive.node.channel.handlers[EMCY + 2](b"\x20\x03\x11")
    (event,) = robot.events.take()
    assert event.text.startswith("drive of axis 1: 0x0320, register 0x11: meaning 320")
    for code in (1, 2, 3):
        assert robot.emergency(robot.drive, bytes([code, 0x90, 0])) == ["emcy can1/2"], "each kind"


def test_an_emergency_that_is_too_short(robot: Robot) -> None:
    assert robot.emergency(robot.drive, b"\x20\x83") == ["short_emcy can1/2"]
    assert robot.exchange.error_codes == [0] * 4
