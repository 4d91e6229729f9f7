"""What the supervisor reads of frames and records, by the wiring of the configuration."""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import Any

import can
import numpy as np
import pytest
from can.interfaces.socketcan import SocketcanBus

from tests.unit.supervisor_setup import (
    STRICT,
    FakeBus,
    N,
)
from tonus.config import Config, load
from tonus.config.schema.bus import CanopenBus
from tonus.config.schema.bus.canopen import CellNode
from tonus.drivers.fieldbus import RAW_FRAME
from tonus.runtime.recording.ring import RingReader, RingWriter
from tonus.runtime.signals import cycle_dtype
from tonus.runtime.states import State
from tonus.runtime.supervisor.listener import Heard, Listener, Watched
from tonus.runtime.supervisor.record import claims, of_ring
from tonus.runtime.supervisor.wiring import Value, Wiring


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/can.yaml", overrides=STRICT)[0]


def test_numbers_of_a_frame() -> None:
    assert Value(16, 16).number(0xFFFE_0001) == -2
    assert Value(16, 16).number(0x8000_0001) == -32768
    assert Value(16, 16).number(0x7FFF_FFFF) == 32767
    word = int.from_bytes(b"\0\0" + struct.pack("<f", -1.5), "little")
    assert Value(16, 32, real=True).number(word) == -1.5


WATCHED = [Watched(0x201, 4, (Value(16, 16),))]


def test_what_has_no_statusword_is_not_powered() -> None:
    """Whatever is in it; nor is a drive that has not answered yet."""
    heard = Heard((Value(16, 16),))
    heard.take([0x0237], 1)
    assert not heard.powered
    assert not Heard((), Value(0, 16)).powered
    heard.take([0x0233], 2)
    assert not heard.startable
    drive = Heard((), Value(16, 16))
    for statusword, startable in ((0x0231, True), (0x0233, True), (0x0237, False)):
        drive.take([statusword << 16], 1)
        assert drive.startable == startable


@pytest.mark.parametrize("shift", [0, 16])
def test_a_drive_that_failed_and_one_that_is_told_to_have_power(shift: int) -> None:
    """Wherever its statusword and controlword stand in a frame."""
    drive, command = Heard((), Value(shift, 16)), Heard((), None, Value(shift, 16))
    for statusword, failed in ((0x0208, True), (0x020F, True), (0x0237, False), (0x0250, False)):
        drive.take([statusword << shift], 1)
        assert drive.failed is failed
    for number, (controlword, enables) in enumerate(((0x0F, True), (0x07, False), (0x1F, True))):
        command.take([controlword << shift], 1)
        assert command.enables is enables
        assert command.on == (1, 1, 2)[number]


def test_the_first_number_of_every_command_is_kept() -> None:
    """Whether it acts on a SYNC or at once, and whatever else the frame has."""
    bus, values = FakeBus(), (Value(16, 16), Value(0, 16))
    syncs = {0x201: 0x80, 0x202: 0}
    watched = [Watched(each, 4, values, command=True, sync=sync) for each, sync in syncs.items()]
    listener = Listener(bus, watched)
    bus.waiting = _frames((0x201, 5), (0x202, 5), (0x201, 7), (0x202, 7))
    listener.read(1)
    assert [list(listener.heard[each].numbers) for each in syncs] == [[5.0, 7.0]] * 2


def test_a_listener_on_messages() -> None:
    bus = FakeBus()
    listener = Listener(bus, WATCHED)
    good = can.Message(arbitration_id=0x201, is_extended_id=False, data=b"\x0f\0\5\0")
    bus.waiting = [
        good,
        good,
        can.Message(arbitration_id=0x201, is_extended_id=False, data=b"\x0f\0\7\0"),
        can.Message(arbitration_id=0x201, is_extended_id=False, data=b"\x0f\0\7"),
        can.Message(arbitration_id=0x201, is_extended_id=True, data=b"\x0f\0\x09\0"),
        can.Message(arbitration_id=0x202, is_extended_id=False, data=b"\x0f\0\x09\0"),
        can.Message(arbitration_id=0x201, is_extended_id=False, is_remote_frame=True, dlc=4),
        can.Message(arbitration_id=0x201, is_extended_id=False, is_error_frame=True, dlc=4),
    ]
    listener.read(7)
    heard = listener.heard[0x201]
    assert (heard.count, heard.same, heard.at_ns, heard.totals) == (3, 0, 7, [17.0])
    bus.waiting = [good] * 3
    listener.read(8)
    assert (heard.count, heard.same) == (6, 2)


def test_a_command_that_is_longer_than_it_need_be_acts_as_well() -> None:
    bus = FakeBus()
    value = Value(16, 16)
    answer, command = Watched(0x181, 4, (value,)), Watched(0x201, 4, (value,), command=True)
    assert (answer.sizes, command.sizes) == (range(4, 5), range(4, 9))
    listener = Listener(bus, [answer, command])
    for identifier in (0x181, 0x201):
        for data in (b"\x0f\0\5", b"\x0f\x81\5\0", b"\x0f\0\7\0\0\0\0\0"):
            frame = can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
            bus.waiting.append(frame)
    listener.read(7)
    short, long = listener.heard[0x181], listener.heard[0x201]
    assert (short.count, short.word, short.totals) == (1, 0x5810F, [5.0])
    assert (long.count, long.word, long.totals) == (2, 0x7000F, [12.0])


def _frames(*frames: tuple[int, int]) -> list[can.Message]:
    """SYNCs where the identifier is 0x80, otherwise commands with this torque."""
    return [
        can.Message(
            arbitration_id=identifier,
            is_extended_id=False,
            data=b"" if identifier == 0x80 else b"\x0f\0" + struct.pack("<h", torque),
        )
        for identifier, torque in frames
    ]


def test_a_command_counts_where_its_sync_makes_it_act() -> None:
    """The newest before each SYNC, whichever look brings it; each is a number that was sent."""
    bus = FakeBus()
    listener = Listener(bus, [Watched(0x201, 4, (Value(16, 16),), command=True, sync=0x80)])
    heard = listener.heard[0x201]

    def look(now_ns: int, *frames: tuple[int, int]) -> tuple[int, int, int, int, list[float]]:
        bus.waiting = _frames(*frames)
        listener.read(now_ns)
        numbers = list(heard.numbers)
        heard.numbers.clear()
        return heard.count, heard.word >> 16, heard.at_ns, heard.same, numbers

    assert look(1, (0x201, 5)) == (0, 0, 0, 0, [5.0]), "it waits"
    assert look(2) == (0, 0, 0, 0, [])
    assert look(3, (0x80, 0), (0x201, 9)) == (1, 5, 3, 0, [9.0])
    assert look(4, (0x201, 6), (0x201, 7), (0x80, 0), (0x201, 8)) == (2, 7, 4, 0, [6.0, 7.0, 8.0])
    assert look(5, (0x80, 0), (0x80, 0)) == (3, 8, 5, 0, []), "the second finds nothing new"
    twice = look(6, (0x201, 8), (0x80, 0), (0x201, 8), (0x80, 0))
    assert twice == (5, 8, 6, 2, [8.0, 8.0])
    assert heard.totals == [5.0 + 7.0 + 3 * 8.0]
    assert look(7, (0x201, 3)) == (5, 8, 6, 2, [3.0])


def test_a_sync_makes_every_drive_of_its_identifier_act_and_no_other() -> None:
    bus = FakeBus()
    value = (Value(16, 16),)
    syncs = {0x201: 0x80, 0x202: 0x80, 0x203: 0x81, 0x204: 0}
    watched = [Watched(each, 4, value, command=True, sync=sync) for each, sync in syncs.items()]
    listener = Listener(bus, watched)
    bus.waiting = _frames((0x201, 1), (0x202, 2), (0x203, 3), (0x204, 4), (0x80, 0))
    listener.read(1)
    assert [listener.heard[each].totals[0] for each in syncs] == [1.0, 2.0, 0.0, 4.0]


def test_a_listener_on_arrays_of_frames() -> None:
    word = -1 << 32 | 0x0005_000F
    bus = FakeBus()
    bus.receive_frames = lambda _: np.array([(1, 0x201, 4, 0, 0, word)], RAW_FRAME)  # type: ignore[attr-defined]
    listener = Listener(bus, WATCHED)
    listener.read(9)
    assert listener.heard[0x201].totals == [5.0]
    assert listener.heard[0x201].word == 0xFFFF_FFFF_0005_000F


@pytest.mark.parametrize("shift", [0, 16])
def test_frames_of_one_look_count_as_if_each_had_its_own(shift: int) -> None:
    """Wherever the statusword stands in them."""
    state = Value(shift, 16)
    words = [
        off_or_on << shift | number << 16 - shift
        for off_or_on, number in zip(
            (0x27, 0x27, 0x07, 0x40, 0x27, 0x27, 0x27), (1, 1, -2 & 0xFFFF, 3, 3, 3, 3), strict=True
        )
    ]
    values = (Value(16 - shift, 16), Value(0, 8))
    together, apart = (Heard(values, state) for _ in range(2))
    together.take(words[:2], 1)
    together.take(words[2:], 2)
    for at, word in enumerate(words):
        apart.take([word], 1 + (at > 1))
    for name in Heard.__slots__:
        assert getattr(together, name) == getattr(apart, name)
    assert (together.count, together.same, together.on, together.powered) == (7, 3, 6, True)
    assert together.totals[0] == 12.0
    assert list(together.numbers) == [1, 1, -2, 3, 3, 3, 3]


def test_a_channel_that_fails_in_mid_look_gives_what_came_before() -> None:
    bus = FakeBus()

    def fail(timeout: float | None = None) -> can.Message:
        if bus.waiting:
            return bus.waiting.pop()
        raise can.CanOperationError("gone")

    bus.waiting = [can.Message(arbitration_id=0x201, is_extended_id=False, data=bytes(4))]
    bus.recv = fail  # type: ignore[method-assign]
    listener = Listener(bus, WATCHED)
    with pytest.raises(can.CanOperationError):
        listener.read(7)
    assert (listener.heard[0x201].count, listener.heard[0x201].at_ns) == (1, 7)


def test_a_listener_takes_no_more_than_its_share_of_a_flood() -> None:
    bus = FakeBus()
    listener = Listener(bus, WATCHED)
    frame = can.Message(arbitration_id=0x201, is_extended_id=False, data=bytes(4))
    bus.waiting = [frame] * 5000
    listener.read(1)
    assert listener.heard[0x201].count == 4096


def test_a_listener_on_the_kernels_frames() -> None:
    frames = [struct.pack("<IB3x8s", 0x201, 4, b"\x0f\0\5\0")] * 5000

    def receive(_: int) -> bytes:
        assert blocking
        assert not blocking[-1]
        if not frames:
            raise BlockingIOError
        return frames.pop()

    bus = SocketcanBus.__new__(SocketcanBus)
    bus._is_shutdown = True
    blocking: list[bool] = []
    bus.socket = SimpleNamespace(setblocking=blocking.append, recv=receive)  # type: ignore[assignment]
    listener = Listener(bus, WATCHED)
    listener.read(1)
    assert listener.heard[0x201].count == 4096
    listener.read(2)
    assert listener.heard[0x201].count == 5000


def test_records_of_a_ring(tmp_path: Any) -> None:
    dtype = cycle_dtype(N)
    writer = RingWriter.create(tmp_path / "ring", dtype.itemsize, 16, {"kind": "record"})
    records = of_ring(RingReader.look(tmp_path / "ring"), N)
    record = np.zeros(1, dtype)
    for tick in range(3):
        record["stiffness"]["k_eq"] = 1000.0 + tick
        record["state"]["state"] = State.HOLD
        writer.publish(record.view(np.uint8), tick)
    assert [each.stiffness for each in claims(records())] == [1000.0, 1001.0, 1002.0]
    assert claims(records()) == []
    writer.close()


def test_wiring_of_an_axis_and_a_cell() -> None:
    """Identifiers, sizes and scales, by hand from the configuration: unlike axes, two signs."""
    robot = load("config/unlike_axes.yaml")[0].robot
    config = load("config/can.yaml")[0].model_copy(update={"robot": robot})
    assert isinstance(config.fieldbus, CanopenBus)
    wiring = Wiring(config)
    assert {config.robot.signs[axis.number] for axis in wiring.axes} == {1, -1}
    for axis in wiring.axes:
        train = config.robot.drive_trains[axis.number]
        node, sign = axis.number + 1, config.robot.signs[axis.number]
        assert (axis.sent, axis.received) == (0x200 + node, 0x180 + node)
        assert (axis.sent_bytes, axis.received_bytes) == (4, 8)
        assert (axis.heartbeat, axis.sync, axis.request) == (0x700 + node, 0x080, 0x600 + node)
        turns = 1.0 / train.motor.increments_per_revolution / train.gearbox.ratio
        assert axis.metre == pytest.approx(sign * 3.14159265 * 2.0 * train.drum.radius * turns)
        motor = 1e-3 * train.motor.rated_torque
        assert axis.newton == pytest.approx(sign * motor * train.gearbox.ratio / train.drum.radius)
        assert axis.per_newton_metre == pytest.approx(sign / (motor * train.gearbox.ratio))
        assert axis.mass * train.drum.radius**2 == pytest.approx(train.drum.inertia)
        assert axis.damping * train.drum.radius**2 == pytest.approx(train.drum.viscous_friction)
    for cell in wiring.cells:
        assert (cell.received, cell.received_bytes) == (0x180 + 17 + cell.number, 4)
        assert cell.newton == 10.0**-config.fieldbus.force_cell.decimal_digits


def test_wiring_of_other_devices(config: Config) -> None:
    """A float for a force, an amplifier of several cells, a drive that alone knows its scale."""
    assert isinstance(config.fieldbus, CanopenBus)
    amplifier = CellNode(cells=(1, 0), node_id=17)
    channel = config.fieldbus.channels[0].model_copy(update={"force_cells": (amplifier,)})
    bus = config.fieldbus.model_copy(update={"channels": (channel,)})
    cells = Wiring(config.model_copy(update={"fieldbus": bus})).cells
    assert [(cell.number, cell.received, cell.force) for cell in cells] == [
        (1, 0x191, Value(0, 16)),
        (0, 0x191, Value(16, 16)),
    ]
    floats = config.fieldbus.force_cell.model_copy(update={"tpdo": (0x61300120,)})
    bus = config.fieldbus.model_copy(update={"force_cell": floats})
    real = Wiring(config.model_copy(update={"fieldbus": bus})).cells[0]
    assert (real.force.real, real.newton, real.received_bytes) == (True, 1.0, 4)
    mixed, _ = load("config/mixed_drives.yaml")
    assert any(axis.newton is None for axis in Wiring(mixed).axes)
    assert Wiring(load("config/ethercat.yaml")[0]).channels == []
    drive = config.fieldbus.every_profile["fieldbus.drive"].model_copy(
        update={"tpdo": (0x60410010,)}
    )
    with pytest.raises(ValueError, match="no PDO maps 0x6064"):
        Wiring(
            config.model_copy(
                update={"fieldbus": config.fieldbus.model_copy(update={"drive": drive})}
            )
        )
