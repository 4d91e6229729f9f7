"""Several channels of a lab in this process, sent to in one call."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tonus.sim.can.registry import Advancing
from tonus.sim.can.wire.inbox import FRAMES
from tonus.sim.can.wire.port import Port
from tonus.sim.can.wire.regular import Integers, WireTable


class JoinedBuses:
    """``ports`` are those of a host, one on each channel."""

    def __init__(self, lab: Advancing, ports: Sequence[Port]) -> None:
        self._lab = lab
        self._ports = ports
        self._inboxes = [port.received for port in ports if port.received is not None]
        self._channels = np.arange(len(ports), dtype=np.uint16)
        self._numbers = np.array([port.number for port in ports], np.int64)
        self._table: WireTable | None = None
        self._rows: Integers = np.zeros(len(ports), np.int64)

    def receive_joined(self, limit: int) -> NDArray[np.void] | None:
        """What has arrived, (n,) of `FRAMES`, channel by channel. None where one has more than its
        share of ``limit``: each bus has to be asked by itself."""
        lab = self._lab
        lab.advance(lab.clock())
        counts = [len(inbox) for inbox in self._inboxes]
        if max(counts) * len(counts) > limit:
            return None
        taken = [inbox.take(count).data for inbox, count in zip(self._inboxes, counts, strict=True)]
        frames = np.frombuffer(bytearray().join(taken), FRAMES)
        frames["channel"] = self._channels.repeat(counts)
        return frames

    def send_joined(self, frames: NDArray[np.void], sent_ns: int) -> bool:
        """Queue data frames of 11-bit identifiers, (n,) of `FRAMES`, each by the port that its
        channel counts. False: nothing was done, and each has to be sent by itself."""
        # The wires of a lab are in one table, and in another one after any of them has changed.
        table = self._ports[0].channel.wire.table
        if table is not self._table:
            wires = [port.channel.wire for port in self._ports]
            if any(wire.table is not table for wire in wires):
                return False
            self._table, self._rows[:] = table, [wire.row for wire in wires]
        return sent_ns == self._lab.now_ns and table.put(self._rows, self._numbers, frames, sent_ns)
