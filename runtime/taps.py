"""Rings with a payload of their own: raw bus frames, events for people, and keyframes."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from enum import IntEnum
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from runtime.ring import RingWriter

FRAME = np.dtype(
    [
        ("identifier", "<u4"),  # bit 31 extended, 30 remote, 29 error
        ("channel", "u1"),  # index into the ring's meta "channels"
        ("dlc", "u1"),
        ("flags", "u1"),  # SENT
        ("padding", "u1"),
        ("data", "u1", (8,)),
    ]
)
SENT = 1
"""flag of a frame that we sent"""

EVENT = np.dtype(
    [
        ("tick", "<u8"),
        ("level", "u1"),  # Level
        ("name", "S32"),
        ("where", "S32"),
        ("text", "S439"),
    ]
)

KEYFRAME_BYTES = 1 << 17
KEYFRAME = np.dtype([("tick", "<u8"), ("size", "<u8"), ("state", "u1", (KEYFRAME_BYTES,))])


class Level(IntEnum):
    """As in rcl_interfaces/msg/Log."""

    DEBUG = 10
    INFO = 20
    WARNING = 30
    ERROR = 40
    FATAL = 50


_FRAME = struct.Struct("<qIBBBx8s")


class FrameRing(RingWriter):
    """Every frame of a bus, as it is sent and received."""

    @classmethod
    def open(cls, path: Path, channels: Sequence[str], capacity: int) -> Self:
        """A new ring for the named channels; frames refer to them by index."""
        meta = {"kind": "frames", "channels": list(channels)}
        return cls.create(path, FRAME.itemsize, capacity, meta)

    def tap(self, stamp_ns: int, channel: int, identifier: int, data: bytes, sent: bool) -> None:
        """Record one frame; ``identifier`` carries its extended, remote and error bits."""
        slot = self._slot
        self._words[slot] = 0
        _FRAME.pack_into(
            self._memory, slot * 8 + 8, stamp_ns, identifier, channel, len(data), sent, data
        )
        self._release(slot)


class EventRing(RingWriter):
    """What a person wants to know about a run: a few a second at most."""

    @classmethod
    def open(cls, path: Path, capacity: int = 4096) -> Self:
        return cls.create(path, EVENT.itemsize, capacity, {"kind": "events"})

    def write(
        self, stamp_ns: int, tick: int, level: Level, name: str, where: str = "", text: str = ""
    ) -> None:
        """Record an event; what is too long for its field is cut at a character."""
        record = np.zeros(1, EVENT)
        record["tick"], record["level"] = tick, level
        record["name"], record["where"] = _cut(name, 32), _cut(where, 32)
        record["text"] = _cut(text, 439)
        self.publish(record, stamp_ns)


class KeyframeRing(RingWriter):
    """The cycle's whole state, every few seconds."""

    _record: NDArray[np.void]

    @classmethod
    def open(cls, path: Path, capacity: int = 8) -> Self:
        ring = cls.create(path, KEYFRAME.itemsize, capacity, {"kind": "keyframes"})
        ring._record = np.zeros(1, KEYFRAME)
        return ring

    def write(self, stamp_ns: int, tick: int, state: bytes) -> None:
        """Record the state after ``tick``; one that is too large is left out, and a replay begins
        at an earlier one."""
        if len(state) > KEYFRAME_BYTES:
            return
        record = self._record
        record["tick"], record["size"] = tick, len(state)
        record["state"][0, : len(state)] = np.frombuffer(state, np.uint8)
        record["state"][0, len(state) :] = 0
        self.publish(record, stamp_ns)


def _cut(text: str, size: int) -> bytes:
    return text.encode()[:size].decode(errors="ignore").encode()
