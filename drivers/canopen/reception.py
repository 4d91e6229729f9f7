"""The regular answers of a tick, booked and taken apart by compiled code.

A channel brings some five TPDOs a tick, and nearly every one as it should: whole, in its own
period even if it is read later, from a node that owes no other. Those of all channels are booked
here in one call, frame by frame in the order they came. What is different in any way stops the
kernel; its `Channel` looks at that frame, and the kernel goes on behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.drivers.canopen.syncs import ANSWER, HISTORY, Syncs, SyncTable, word_of
from tonus.drivers.cia301.pdo import Kind, Mapping
from tonus.drivers.exchange import NOT_YET, Exchange
from tonus.drivers.fieldbus import RAW_FRAME

_IDENTIFIERS = 1 << 11
_NODES = 127
_NOBODY = -1
_TICK, _TIME, _DOUBT = -1, -2, -3

FIELD = np.dtype([("kind", "i8"), ("shift", "i8"), ("bits", "i8"), ("place", "i8"), ("real", "i8")])


class Field(NamedTuple):
    """One value of a PDO, and its place among the exchange's words; in the order of `FIELD`."""

    kind: int
    """`Kind`, or tick, time or doubt of the sample"""
    shift: int
    """its first bit"""
    bits: int
    place: int
    floating: bool
    """the place holds a float"""


def tick_field(place: int) -> Field:
    """The tick that was sampled."""
    return Field(_TICK, 0, 0, place, False)


def time_field(place: int) -> Field:
    """When the SYNC of that tick went out, in ns."""
    return Field(_TIME, 0, 0, place, False)


def doubt_field(place: int) -> Field:
    """By how much later, in ns."""
    return Field(_DOUBT, 0, 0, place, False)


def mapped(mapping: Mapping, entry: int, place: int, *, floating: bool = False) -> Field:
    """A mapped object. Raises `PdoError` if it is not mapped."""
    kind, shift, bits = mapping.bits(entry)
    return Field(kind, shift, bits, place, floating)


@njit(cache=True)
def store_field(
    field: Any,
    value: int,
    sync: tuple[int, int, int],
    integers: NDArray[np.int64],
    reals: NDArray[np.float64],
) -> None:
    """``field`` is a row of `FIELD`, ``value`` that of its bits, signed; ``sync``: tick, time and
    doubt (ns) of the sample."""
    if field.kind == _TICK:
        integers[field.place] = sync[0]
        return
    if field.kind == _TIME:
        integers[field.place] = sync[1]
        return
    if field.kind == _DOUBT:
        integers[field.place] = sync[2]
        return
    if field.kind == Kind.UNSIGNED and field.bits < 64:
        value &= (1 << field.bits) - 1
    if field.kind == Kind.REAL:
        reals[field.place] = np.int32(value).view(np.float32)
    elif field.real:
        reals[field.place] = value
    else:
        integers[field.place] = value


@njit(cache=True)
def _store(
    word: int,
    sync: tuple[int, int, int],
    fields: NDArray[np.void],
    first: int,
    count: int,
    integers: NDArray[np.int64],
    reals: NDArray[np.float64],
) -> None:
    """Take eight bytes apart. ``sync``: tick, time and doubt (ns) of the one they answer."""
    for i in range(first, first + count):
        field = fields[i]
        value = (word << (64 - field.shift - field.bits)) >> (64 - field.bits)
        store_field(field, value, sync, integers, reals)


@njit(cache=True)
def _receive(
    frames: NDArray[np.void],
    at: int,
    now_ns: int,
    late: int,
    counts: NDArray[np.int64],
    bits_ns: NDArray[np.int64],
    stamps_ns: NDArray[np.int64],
    times_ns: NDArray[np.int64],
    doubts_ns: NDArray[np.int64],
    ticks: NDArray[np.int64],
    slots: NDArray[np.int16],
    answers: NDArray[np.void],
    fields: NDArray[np.void],
    integers: NDArray[np.int64],
    reals: NDArray[np.float64],
) -> int:
    """Book regular answers from frame ``at`` on: the first frame that is none, or their number. The
    channel of a frame is the row of its SYNCs and slots."""
    for i in range(at, len(frames)):
        frame = frames[i]
        if frame.own:
            continue
        if frame.identifier >= slots.shape[1]:
            return i
        channel = frame.channel
        slot = slots[channel, frame.identifier]
        if slot == _NOBODY:
            return i
        answer, newest = answers[slot], counts[channel]
        stamp_ns = frame.stamp_ns if 0 < frame.stamp_ns < now_ns else now_ns
        sent_ns = stamp_ns - answer.bits * bits_ns[channel]
        due = answer.answered + 1
        if (
            frame.dlc != answer.size
            or answer.period >= due
            or answer.fresh
            or not newest - late <= due <= newest
            or sent_ns < times_ns[channel, due % HISTORY]
            or (due < newest and sent_ns >= times_ns[channel, (due + 1) % HISTORY])
        ):
            return i
        answer.answered = due
        answer.period = due
        answer.data = frame.data
        answer.stamp_ns = stamp_ns
        stamps_ns[channel] = stamp_ns
        place = due % HISTORY
        sync = (ticks[channel, place], times_ns[channel, place], doubts_ns[channel, place])
        _store(frame.data, sync, fields, answer.first, answer.fields, integers, reals)
    return len(frames)


class Reception:
    """Who answers on the channels of a fieldbus, and what is in the answers."""

    def __init__(self, channels: int, late_ticks: int) -> None:
        self._table = table = SyncTable(channels)
        self.syncs = [Syncs(table, row) for row in range(channels)]
        """of each channel"""
        self._late = late_ticks
        self._slots = np.full((channels, _IDENTIFIERS), _NOBODY, np.int16)
        self._answers = np.zeros(channels * _NODES, ANSWER)
        self._nodes = 0
        self._fields = np.zeros(0, FIELD)
        self._words = (np.zeros(0, np.int64), np.zeros(0))

    def add(
        self,
        channel: int,
        identifier: int,
        size: int,
        fields: Sequence[Field],
        exchange: Exchange,
    ) -> np.void:
        """A node's PDO of ``size`` bytes; all go into one ``exchange``. Its account of answers is
        for `Arrival`."""
        slot, self._nodes = self._nodes, self._nodes + 1
        self._slots[channel, identifier] = slot
        answer: np.void = self._answers[slot]
        answer["size"], answer["first"], answer["fields"] = size, len(self._fields), len(fields)
        self._fields = np.concatenate((self._fields, np.array(fields, FIELD)))
        self._words = (exchange.integers, exchange.reals)
        self(np.zeros(0, RAW_FRAME), 0, 0)  # compiles it before a tick needs it
        self.store(channel, answer, bytes(size), NOT_YET)
        return answer

    def __call__(self, frames: NDArray[np.void], at: int, now_ns: int) -> int:
        """Book what is regular of ``frames`` (n,), from ``at`` on and up to the first that is not:
        its index, or n."""
        table = self._table
        behind: int = _receive(
            frames, at, now_ns, self._late, table.counts, table.bits_ns, table.stamps_ns,
            table.times_ns, table.doubts_ns, table.ticks,
            self._slots, self._answers, self._fields, *self._words,
        )  # fmt: skip
        return behind

    def store(self, channel: int, answer: np.void, data: bytes, tick: int) -> None:
        """Take an answer apart that `Arrival` has booked to ``tick``."""
        first, count = int(answer["first"]), int(answer["fields"])
        sync = self.syncs[channel].of(tick)
        _store(word_of(data), sync, self._fields, first, count, *self._words)
