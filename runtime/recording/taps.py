"""Rings with a payload of their own: raw bus frames, events for people, and keyframes."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
from numba import njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from tonus.drivers.fieldbus import RAW_FRAME
from tonus.runtime.recording.payloads import (
    EVENT,
    FRAME,
    KEYFRAME,
    KEYFRAME_BYTES,
    SENT,
    Level,
)
from tonus.runtime.recording.ring import PUBLISHED_AT, RingWriter

__all__ = [
    "EVENT",
    "FRAME",
    "KEYFRAME",
    "KEYFRAME_BYTES",
    "SENT",
    "EventRing",
    "FrameRing",
    "KeyframeRing",
    "Level",
]

_FRAME = struct.Struct("<qIBBBx8s")
_REMOTE = 1 << 30
_CHANNEL_BIT, _LENGTH_BIT, _FLAGS_BIT = 32, 40, 48


@intrinsic
def _fence(typing_context: Any) -> Any:
    """What stands before it is stored before what stands behind it. A compiler may else leave out,
    or put off, what only another process sees; the processor keeps the order by itself."""
    del typing_context

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        del signature, arguments
        builder.fence("acq_rel")
        return context.get_dummy_value()

    return types.void(), generate


@njit(cache=True)
def _record(
    words: NDArray[np.int64],
    ring: tuple[int, int, int],
    begin: int,
    recorded: int,
    frames: NDArray[np.void],
    channel: int,
    flags: int,
    now_ns: int,
) -> tuple[int, int]:
    """All frames but those received from ourselves, with these flags, from slot ``begin`` on, after
    ``recorded`` ones: first the positions are taken away, then the slots filled, then the positions
    given. Returns the slot behind the last, and how many they are."""
    first, stride, end = ring
    slot, count = begin, 0
    for i in range(frames.shape[0]):
        if frames[i].own:
            continue
        count += 1
        words[slot] = 0
        slot = slot + stride if slot + stride != end else first
    _fence()  # type: ignore[call-arg]  # numba gives the argument
    slot = begin
    for i in range(frames.shape[0]):
        frame = frames[i]
        if frame.own:
            continue
        length = 0 if frame.identifier & _REMOTE else 8 if frame.dlc > 8 else int(frame.dlc)
        place = channel + int(frame.channel)
        head = int(frame.identifier) | place << _CHANNEL_BIT | length << _LENGTH_BIT
        head |= flags << _FLAGS_BIT
        words[slot + 1] = frame.stamp_ns if 0 < frame.stamp_ns < now_ns else now_ns
        words[slot + 2] = head
        words[slot + 3] = frame.data & ((1 << 8 * length) - 1 if length < 8 else -1)
        slot = slot + stride if slot + stride != end else first
    _fence()
    slot = begin
    for i in range(count):
        words[slot] = recorded + i + 1
        slot = slot + stride if slot + stride != end else first
    _fence()
    words[PUBLISHED_AT] = recorded + count
    return slot, count


def compile_frames() -> None:
    """What takes frames as they were received, before a tick needs it."""
    _record(np.zeros(8, np.int64), (0, 8, 8), 0, 0, np.zeros(0, RAW_FRAME), 0, 0, 0)


class FrameRing(RingWriter):
    """Every frame of a bus, as it is sent and received."""

    _array: NDArray[np.int64]
    _shape: tuple[int, int, int]
    """first slot, words from slot to slot, end"""

    @classmethod
    def open(
        cls, path: Path, channels: Sequence[str], capacity: int, *, touched: bool = True
    ) -> Self:
        """A new ring for the named channels; frames refer to them by index."""
        meta = {"kind": "frames", "channels": list(channels)}
        ring = cls.create(path, FRAME.itemsize, capacity, meta, touched=touched)
        ring._array = np.frombuffer(ring._memory, np.int64, len(ring._words))
        ring._shape = (ring._first, ring._stride, ring._end)
        compile_frames()
        return ring

    def received(self, frames: NDArray[np.void], channel: int, now_ns: int) -> None:
        """As `tonus.drivers.fieldbus.FrameTap` has it, at most as many as the ring holds."""
        self._write(frames, channel, 0, now_ns)

    def sent_together(self, frames: NDArray[np.void], channel: int, now_ns: int) -> None:
        """As `tonus.drivers.fieldbus.FrameTap` has it, at most as many as the ring holds."""
        self._write(frames, channel, SENT, now_ns)

    def _write(self, frames: NDArray[np.void], channel: int, flags: int, now_ns: int) -> None:
        self._slot, count = _record(
            self._array, self._shape, self._slot, self.count, frames, channel, flags, now_ns
        )
        self.count += count

    def close(self) -> None:
        del self._array
        super().close()

    def frame(
        self, stamp_ns: int, channel: int, identifier: int, data: bytes, *, sent: bool
    ) -> None:
        """Record one frame; ``identifier`` carries its extended, remote and error bits."""
        slot = self._slot
        self._words[slot] = 0
        _FRAME.pack_into(
            self._memory, slot * 8 + 8, stamp_ns, identifier, channel, len(data), sent, data
        )
        self._release(slot)

    def sent(self, frames: Sequence[tuple[int, bytes]], channel: int, now_ns: int) -> None:
        """As `tonus.drivers.fieldbus.FrameTap` has it."""
        words, pack, memory = self._words, _FRAME.pack_into, self._memory
        slot, count = self._slot, self.count
        for identifier, data in frames:
            words[slot] = 0
            pack(memory, slot * 8 + 8, now_ns, identifier, channel, len(data), True, data)
            count += 1
            words[slot] = words[PUBLISHED_AT] = count
            slot += self._stride
            if slot == self._end:
                slot = self._first
        self._slot, self.count = slot, count


class EventRing(RingWriter):
    """What a person wants to know about a run: a few a second at most."""

    @classmethod
    def open(cls, path: Path, capacity: int = 4096, *, touched: bool = True) -> Self:
        return cls.create(path, EVENT.itemsize, capacity, {"kind": "events"}, touched=touched)

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
    def open(cls, path: Path, capacity: int = 8, *, touched: bool = True) -> Self:
        meta = {"kind": "keyframes"}
        ring = cls.create(path, KEYFRAME.itemsize, capacity, meta, touched=touched)
        ring._record = np.zeros(1, KEYFRAME)
        return ring

    def write(self, stamp_ns: int, tick: int, state: bytes) -> bool:
        """Record the state after ``tick``; gives False for one that is too large and left out: a
        replay then begins at an earlier one."""
        if len(state) > KEYFRAME_BYTES:
            return False
        record = self._record
        record["tick"], record["size"] = tick, len(state)
        record["state"][0, : len(state)] = np.frombuffer(state, np.uint8)
        record["state"][0, len(state) :] = 0
        self.publish(record, stamp_ns)
        return True


def _cut(text: str, size: int) -> bytes:
    return text.encode()[:size].decode(errors="ignore").encode()
