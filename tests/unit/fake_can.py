"""A scripted CAN bus with small answering nodes, for tests of the master without a lab."""

from __future__ import annotations

import asyncio
import struct
from collections import deque
from collections.abc import Coroutine, Sequence
from typing import Any, TypeVar

import can
import numpy as np
from numpy.typing import NDArray

from tonus.config import Config, load
from tonus.config.schema.bus import CanopenBus
from tonus.drivers.canopen.frames import data_of
from tonus.drivers.canopen.master import CanopenFieldbus
from tonus.drivers.fieldbus import FrameTap
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.timing.clock import VirtualTimeLoop

Result = TypeVar("Result")
DRIVE_TPDO = struct.Struct("<Hih")
CELL_TPDO = struct.Struct("<i")


class FakeNode:
    """Answers NMT and expedited SDO from a dictionary; nothing else."""

    def __init__(self, node_id: int, objects: dict[tuple[int, int], bytes]) -> None:
        self.node_id = node_id
        self.objects = objects
        self.aborts: dict[tuple[int, int], int] = {}
        self.stuck: dict[tuple[int, int], bytes] = {}
        """objects that read back the same whatever is written"""
        self.present = True
        self.starts = True
        self.resets = 0
        self.deaf_to = 0
        """resets that pass before it hears, as while it looks for the bit rate"""

    def answer(self, identifier: int, data: bytes) -> list[tuple[int, bytes]]:
        if not self.present:
            return []
        if identifier == 0 and data[1] in (0, self.node_id):
            return self._nmt(data[0])
        if identifier == 0x600 + self.node_id and data[0] != 0x80:
            return [(0x580 + self.node_id, self._sdo(data))]
        return []

    def _nmt(self, command: int) -> list[tuple[int, bytes]]:
        if command in (0x81, 0x82):
            self.resets += 1
            if self.resets <= self.deaf_to:
                return []
            return [(0x700 + self.node_id, b"\x00")]
        if command == 1 and self.starts:
            return [(0x700 + self.node_id, b"\x05")]
        return []

    def _sdo(self, data: bytes) -> bytes:
        command, index, sub = struct.unpack_from("<BHB", data)
        key = (index, sub)
        if key in self.aborts:
            return struct.pack("<BHBI", 0x80, index, sub, self.aborts[key])
        if command == 0x40:
            value = self.stuck.get(key, self.objects.get(key))
            if value is None:
                return struct.pack("<BHBI", 0x80, index, sub, 0x06020000)
            head = 0x43 | (4 - len(value)) << 2
            return struct.pack("<BHB", head, index, sub) + value.ljust(4, b"\0")
        self.objects[key] = data[4 : 8 - (command >> 2 & 3)]
        return struct.pack("<BHB4x", 0x60, index, sub)


class ScriptedBus(can.BusABC):
    """Keeps what is sent, gives what is put, and lets its nodes answer at once."""

    def __init__(self, name: str) -> None:
        super().__init__(channel=name)
        self.sent: list[tuple[int, bytes]] = []
        self.inbox: deque[can.Message] = deque()
        self.nodes: list[FakeNode] = []
        self.refuses = False
        self.deaf = False
        self.condition: can.BusState | None = can.BusState.ACTIVE
        self.closed = False
        self.flushes = 0

    def flush_tx_buffer(self) -> None:
        self.flushes += 1

    def put(self, identifier: int, data: bytes = b"", **fields: Any) -> None:
        fields = {"is_extended_id": False, **fields}
        self.inbox.append(can.Message(arbitration_id=identifier, data=data, **fields))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.refuses:
            raise can.CanOperationError("transmit queue full")
        data = bytes(msg.data)
        self.sent.append((msg.arbitration_id, data))
        for node in self.nodes:
            for identifier, reply in node.answer(msg.arbitration_id, data):
                self.put(identifier, reply)

    @property
    def state(self) -> can.BusState:
        if self.condition is None:
            raise can.CanOperationError("the controller does not answer")
        return self.condition

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.deaf:
            raise can.CanOperationError("no such device")
        return (self.inbox.popleft() if self.inbox else None), True

    def shutdown(self) -> None:
        self.closed = True
        super().shutdown()

    def take_sent(self) -> list[tuple[int, bytes]]:
        taken, self.sent = self.sent, []
        return taken


class Tap:
    """Keeps what it hears: time, channel, identifier, data, sent by us."""

    def __init__(self) -> None:
        self.seen: list[tuple[int, int, int, bytes, bool]] = []

    def frame(
        self, stamp_ns: int, channel: int, identifier: int, data: bytes, *, sent: bool
    ) -> None:
        self.seen.append((stamp_ns, channel, identifier, data, sent))

    def sent(self, frames: Sequence[tuple[int, bytes]], channel: int, now_ns: int) -> None:
        for identifier, data in frames:
            self.frame(now_ns, channel, identifier, data, sent=True)

    def sent_together(self, frames: NDArray[np.void], channel: int, now_ns: int) -> None:
        for _, identifier, dlc, _, place, word in frames.tolist():
            data = data_of(identifier, dlc, word)
            self.frame(now_ns, channel + place, identifier, data, sent=True)

    def received(self, frames: NDArray[np.void], channel: int, now_ns: int) -> None:
        for stamp_ns, identifier, dlc, own, place, word in frames.tolist():
            if not own:
                at = stamp_ns if 0 < stamp_ns < now_ns else now_ns
                data = data_of(identifier, dlc, word)
                self.frame(at, channel + place, identifier, data, sent=False)


def in_virtual_time(work: Coroutine[Any, Any, Result]) -> Result:
    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(work)


def u32(value: int) -> bytes:
    return value.to_bytes(4, "little")


class Robot:
    """The whole fieldbus of config/can.yaml on scripted buses."""

    def __init__(self, config: Config | None = None, tap: FrameTap | None = None) -> None:
        self.config = config or load("config/can.yaml")[0]
        fieldbus = self.config.fieldbus
        assert isinstance(fieldbus, CanopenBus)
        self.buses: dict[str, ScriptedBus] = {}
        self.nodes: dict[int, FakeNode] = {}
        self.axis_at: dict[int, tuple[ScriptedBus, int]] = {}
        self.cell_at: dict[int, tuple[ScriptedBus, int]] = {}
        for channel in fieldbus.channels:
            bus = self.buses[channel.name] = ScriptedBus(channel.name)
            for drive in channel.drives:
                self._add(bus, drive.node_id, self._drive())
                self.axis_at[drive.axis] = (bus, drive.node_id)
            for amplifier in channel.force_cells:
                self._add(bus, amplifier.node_id, self._cell(len(amplifier.cells)))
                for cell in amplifier.cells:
                    self.cell_at[cell] = (bus, amplifier.node_id)
        self.image = ProcessImage(8)
        self.fieldbus = CanopenFieldbus(
            self.config, self.image, tap, open_bus=lambda name: self.buses[name]
        )
        self.progress: list[str] = []

    def _add(self, bus: ScriptedBus, node_id: int, objects: dict[tuple[int, int], bytes]) -> None:
        node = FakeNode(node_id, objects)
        self.nodes[node_id] = node
        bus.nodes.append(node)

    def _drive(self) -> dict[tuple[int, int], bytes]:
        objects = {
            (0x1018, 1): u32(0xFB),
            (0x1018, 2): u32(0x65510000),
            (0x1018, 3): u32(0x01700000),
            (0x6076, 0): u32(568_000),
            (0x1016, 1): u32(0),
            (0x1016, 2): u32(0),
            (0x1017, 0): bytes(2),
            (0x1029, 1): b"\x01",
            (0x603F, 0): bytes(2),
            (0x6041, 0): b"\x40\x02",
            (0x3010, 1): u32(500),
            (0x6060, 0): b"\x01",
            (0x60C2, 1): b"\x01",
            (0x6071, 0): b"\x05\x00",
            (0x60B2, 0): b"\x2c\x01",
        }
        objects |= {(0x3001, sub): u32(1) for sub in (1, 2, 5)}
        objects |= {(0x3001, 4): b"\x01\x00", (0x6080, 0): u32(50000), (0x6085, 0): u32(10000)}
        objects |= {(index, 0): b"\x01\x00" for index in (0x6007, 0x605A, 0x605B, 0x605C, 0x605E)}
        objects |= {(0x1400 + n, 1): u32(0x200 + n * 0x100) for n in range(4)}
        return objects | {(0x1800 + n, 1): u32(0xC0000180 + n * 0x100) for n in range(4)}

    def _cell(self, channels: int) -> dict[tuple[int, int], bytes]:
        objects = {
            (0x1018, 1): u32(0xFFFF),
            (0x1018, 2): u32(0x404),
            (0x1018, 3): u32(1),
            (0x1017, 0): bytes(2),
            (0x1800, 1): u32(0x40000180),
        }
        for channel in range(1, channels + 1):
            objects |= {(0x6131, channel): u32(0x00210000), (0x6132, channel): b"\x00"}
        return objects

    async def start(self) -> None:
        await self.fieldbus.start(self.progress.append)
        for bus in self.buses.values():
            bus.take_sent()

    def put_axis(
        self, axis: int, statusword: int = 0x1637, position: int = 0, torque: int = 0
    ) -> None:
        bus, node_id = self.axis_at[axis]
        bus.put(0x180 + node_id, DRIVE_TPDO.pack(statusword, position, torque))

    def put_cell(self, cell: int, value: int) -> None:
        bus, node_id = self.cell_at[cell]
        bus.put(0x180 + node_id, CELL_TPDO.pack(value))

    def put_heartbeats(self, *, without: frozenset[int] = frozenset()) -> None:
        for bus in self.buses.values():
            for node in bus.nodes:
                if node.node_id not in without:
                    bus.put(0x700 + node.node_id, b"\x05")

    def put_all(
        self,
        statusword: int = 0x1637,
        *,
        no_axis: frozenset[int] = frozenset(),
        no_cell: frozenset[int] = frozenset(),
    ) -> None:
        for axis in self.axis_at.keys() - no_axis:
            self.put_axis(axis, statusword)
        for cell in self.cell_at.keys() - no_cell:
            self.put_cell(cell, 0)

    def last_rpdo(self, axis: int) -> tuple[int, int]:
        """(controlword, per mille) of the newest frame to an axis."""
        bus, node_id = self.axis_at[axis]
        data = [data for identifier, data in bus.sent if identifier == 0x200 + node_id][-1]
        controlword, torque = struct.unpack("<Hh", data)
        return controlword, torque
