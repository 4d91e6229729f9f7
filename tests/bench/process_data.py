"""What the process data cost the daemon, the far side left out: frames that lie in a socket, and
numbers into the process image and out of it."""

from __future__ import annotations

import os
import socket
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import can
import numpy as np
from numpy.typing import NDArray

from tests.bench.measure import Figure, microseconds
from tonus.config import load
from tonus.config.schema.bus import CanopenBus
from tonus.drivers.canopen.channel import Channel
from tonus.drivers.canopen.channels import Batch, Channels
from tonus.drivers.canopen.identifiers import RPDO1, TPDO1
from tonus.drivers.canopen.reception import Reception
from tonus.drivers.events import EventLog
from tonus.drivers.exchange import Exchange
from tonus.drivers.process_image import AxisCommand, ProcessImage
from tonus.runtime.timing.clock import Stopwatch
from tonus.sim.can import packet

ROUNDS = 3000
PACKETS = ((0, 2), (2, 4), (4, 5))
"""of a channel's answers: what ends within `lab.bus.coalesce_us` comes in one packet"""
_ENABLED = 0x237


class _NoTap:
    """A `FrameTap` that nobody listens to."""

    def frame(
        self, stamp_ns: int, channel: int, identifier: int, data: bytes, *, sent: bool
    ) -> None: ...

    def sent(self, frames: Sequence[tuple[int, bytes]], channel: int, now_ns: int) -> None: ...

    def sent_together(self, frames: NDArray[np.void], channel: int, now_ns: int) -> None: ...

    def received(self, frames: NDArray[np.void], channel: int, now_ns: int) -> None: ...


def process_data() -> list[Figure]:
    """A tick's frames through the lab's sockets, and the exchange's conversions."""
    config, _ = load("config/can.yaml")
    bus = config.fieldbus
    assert isinstance(bus, CanopenBus)
    image = ProcessImage(8)
    exchange = Exchange(
        config.robot,
        bus.force_cell,
        config.control.freshness,
        image,
        EventLog(),
        [str(axis) for axis in range(len(image.axes))],
    )
    exchange.axis_tick[:] = [0] * len(exchange.axis_tick)
    exchange.cell_tick[:] = [0] * len(exchange.cell_tick)
    exchange.statuswords[:] = [_ENABLED] * len(exchange.statuswords)
    image.commands["command"], image.commands["torque"] = AxisCommand.ENABLE, 1.0
    carried, each = _ticks(bus, exchange, carried=True), _ticks(bus, exchange, carried=False)
    peer = "a connection a channel"
    return [
        Figure("send a SYNC on four channels of the lab", carried.sync, "us", peer, each.sync),
        Figure("take a tick's 17 answers from them", carried.taken, "us", peer, each.taken),
        Figure("send eight set-points on them", carried.sent, "us", peer, each.sent),
        Figure("process image from raw values", microseconds(lambda: exchange.fill(1)), "us"),
        Figure("raw values from commands", microseconds(exchange.commands), "us"),
    ]


class _Tick(NamedTuple):
    """us"""

    sync: float
    taken: float
    sent: float


def _ticks(bus: CanopenBus, exchange: Exchange, *, carried: bool) -> _Tick:
    """Medians of processor time."""
    clock, tap = Stopwatch(running=True).processor_ns, _NoTap()
    reception = Reception(len(bus.channels), bus.master.late_ticks)
    nodes = [[each.node_id for each in (*spec.drives, *spec.force_cells)] for spec in bus.channels]
    with _sockets([spec.name for spec in bus.channels]) as (buses, lab):
        channels = [
            Channel(n, ours, bus, 1000, 3, clock, tap, EventLog(), reception)
            for n, ours in enumerate(buses)
        ]
        for number, of_channel in enumerate(nodes):
            for node in of_channel:
                reception.add(number, TPDO1 + node, 8, [], exchange)
        wire = Channels(channels, clock, tap, reception)
        if carried:
            lab[0].send(packet.AGREED)
            wire.drain()
        drives = [
            (n, RPDO1 + d.node_id, 4) for n, spec in enumerate(bus.channels) for d in spec.drives
        ]
        batch = Batch(drives)
        times = np.zeros((ROUNDS, 3))
        for n in range(ROUNDS):
            began = clock()
            wire.sync(n)
            synced = clock()
            for first, last in PACKETS:
                of_channels = [of_channel[first:last] for of_channel in nodes]
                _answer(lab, of_channels, clock(), carried=carried)
            came = clock()
            wire.drain()
            taken = clock()
            batch.fill([bytes(4)] * len(drives))
            wire.send(batch)
            times[n] = synced - began, taken - came, clock() - taken
            for end in lab:
                _empty(end)
        return _Tick(*np.median(times * 1e-3, axis=0).tolist())


def _answer(
    lab: list[socket.socket], nodes: list[list[int]], stamp_ns: int, *, carried: bool
) -> None:
    """One packet with what all channels have, or one from each."""
    packets = [
        b"".join(
            packet.ADDRESSED.pack(stamp_ns, TPDO1 + node, 8, 0, number, bytes(8)) for node in each
        )
        for number, each in enumerate(nodes)
    ]
    if carried:
        lab[0].send(b"".join(packets))
    else:
        for end, data in zip(lab, packets, strict=True):
            if data:
                end.send(data)


def _empty(end: socket.socket) -> None:
    with suppress(BlockingIOError):
        while end.recv(packet.PACKET_BYTES):
            pass


@contextmanager
def _sockets(names: list[str]) -> Iterator[tuple[list[can.BusABC], list[socket.socket]]]:
    """Buses as the daemon opens them, and the lab's ends of their sockets."""
    with (
        tempfile.TemporaryDirectory() as folder,
        patch.dict(os.environ, {"TONUS_RUNTIME_DIR": folder}),
        ExitStack() as stack,
    ):
        buses, ends = [], []
        for name in names:
            listener = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
            listener.bind(str(packet.socket_path(Path(folder), name)))
            listener.listen(1)
            buses.append(can.Bus(interface="tonus", channel=name))
            stack.callback(buses[-1].shutdown)
            end, _ = listener.accept()
            end.setblocking(False)
            ends.append(stack.enter_context(end))
        yield buses, ends
