"""What the process data cost the daemon, the far side left out: frames that lie in a socket, and
numbers into the process image and out of it."""

from __future__ import annotations

import os
import socket
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

import can
import numpy as np
from numpy.typing import NDArray

from tests.bench.measure import Figure, microseconds
from tonus.config import load
from tonus.config.schema.bus import CanopenBus
from tonus.drivers.canopen.channel import Channel
from tonus.drivers.canopen.channels import Channels
from tonus.drivers.canopen.reception import Reception
from tonus.drivers.events import EventLog
from tonus.drivers.exchange import Exchange
from tonus.drivers.process_image import AxisCommand, ProcessImage
from tonus.runtime.timing.clock import Stopwatch
from tonus.sim.can import packet

ROUNDS = 3000
ANSWERS = (0x182, 0x188, 0x192, 0x198, 0x199)
"""Two drives, two cells and the contact cell: the fullest channel."""
SET_POINTS = (0x202, 0x208)
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
    """One channel's frames through the lab's socket, and the exchange's conversions."""
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
    taken, sent = _channel(bus)
    note = "the SYNC and three more channels come on top"
    return [
        Figure("take five answers from a channel", taken, "us", note=note),
        Figure("send two set-points on a channel", sent, "us"),
        Figure("process image from raw values", microseconds(lambda: exchange.fill(1)), "us"),
        Figure("raw values from commands", microseconds(exchange.commands), "us"),
    ]


def _channel(bus: CanopenBus) -> tuple[float, float]:
    """Medians of processor time, us."""
    with _socket_pair() as (ours, lab):
        clock = Stopwatch(running=True).processor_ns
        reception, tap = Reception(1, bus.master.late_ticks), _NoTap()
        channel = Channel(0, ours, bus, 1000, 3, clock, tap, EventLog(), reception)
        wire = Channels((channel,), clock, tap, reception)
        channel.handlers.update(dict.fromkeys(ANSWERS, lambda _: None))
        taken, sent = np.zeros(ROUNDS), np.zeros(ROUNDS)
        for n in range(ROUNDS):
            frames = [packet.FRAME.pack(1, identifier, 8, 0, bytes(8)) for identifier in ANSWERS]
            lab.send(b"".join(frames))
            began = clock()
            wire.drain()
            drained = clock()
            for identifier in SET_POINTS:
                channel.send(identifier, bytes(4))
            taken[n], sent[n] = (drained - began) * 1e-3, (clock() - drained) * 1e-3
            for _ in SET_POINTS:
                lab.recv(packet.PACKET_BYTES)
        return float(np.median(taken)), float(np.median(sent))


@contextmanager
def _socket_pair() -> Iterator[tuple[can.BusABC, socket.socket]]:
    """A bus as the daemon opens it, and the lab's end of its socket."""
    with (
        tempfile.TemporaryDirectory() as folder,
        patch.dict(os.environ, {"TONUS_RUNTIME_DIR": folder}),
        socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener,
    ):
        listener.bind(str(packet.socket_path(Path(folder), "can0")))
        listener.listen(1)
        ours = can.Bus(interface="tonus", channel="can0")
        lab, _ = listener.accept()
        try:
            yield ours, lab
        finally:
            ours.shutdown()
            lab.close()
