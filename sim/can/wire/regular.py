"""A channel on which all is as usual, in compiled code: data frames of base identifiers only, no
errors, no faults. `Channel` works by itself whenever anything else is there, and gives the same.

Three kinds of frames are told apart by their identifiers: most concern hosts only; a held one is
an RPDO that waits for the next SYNC; at all others the wire stops, for the channel to deliver them.
At a SYNC as it should be it waits for the lab, which delivers those of all channels at once.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.sim.can.wire.frame import BASE_ID, BASE_SHIFT, Frame
from tonus.sim.can.wire.inbox import WORDS, Inbox
from tonus.sim.can.wire.latency import Latency
from tonus.sim.can.wire.timing import stuffed_bits

Integers = NDArray[np.int64]

NEVER = 1 << 62
PLAIN, STOPS, HELD = range(3)
"""Kinds of an identifier; from `HELD` on the number of the held frame is added."""
PENDING, FLYING, END, FREE, DELIVERED, BUSY, FRAMES, NEXT = range(8)
"""Places in the state: frames that wait; 1 while one is on the wire; when that ends; when the next
may begin; frames delivered; time on the wire and frames in all; when something happens next."""
ON, WIDE, SYNC, GAP, MOST, ANSWERS, SET_POINTS, RESPONSE = range(8, 16)
"""And further ones: 1 while the wire has the channel; when a frame ended that waits for the lab, or
`NEVER`; identifier of the SYNC; ns between frames; frames that may wait; of the plan, its answers
and its held frames, and how long an answer takes, ns."""
_STATE = 16
DUE, PORT, KEY, IDENTIFIER, DLC, DATA = range(6)
"""Columns of a frame; `DUE` is when it enters its queue, `DATA` as a little-endian integer."""
_COLUMNS = 6
_ROW = struct.Struct("<5q8s")
SENDER, SPAN = WORDS, WORDS + 1
"""Columns of a delivered frame behind those of an inbox: its controller's number, and how long it
took from its queue to its end, ns."""
LEAST, WAITS, HELD_DATA = range(3)
"""Rows of held frames: shortest length, length of the one that waits or 0, its data."""
ROOM = 48
"""Frames that may wait, at most; no plan has more answers, nor more held frames."""
_PLACES = 8
"""Fields of an answer, at most: a byte each."""
_SIZE = 64
_FLIGHT = _SIZE - 1
"""Row of the frame on the wire."""
DONE, _STOPPED, _FULL = range(3)
"""Why a wire went no further."""


@njit("int64(int64, int64)", cache=True)
def _big_endian(data: int, dlc: int) -> int:
    """The payload's bytes as one big-endian number."""
    value = 0
    for place in range(dlc):
        value = value << 8 | (data >> 8 * place & 0xFF)
    return value


@njit("int64(int64[::1], int64[:, ::1])", cache=True)
def _start_ns(state: Integers, frames: Integers) -> int:
    """When the next frame begins; of none, `NEVER`."""
    start = NEVER
    for i in range(state[PENDING]):
        start = min(start, frames[i, DUE])
    return max(start, int(state[FREE]))


@njit("void(int64[::1], int64[:, ::1], int64)", cache=True)
def _take_off(state: Integers, frames: Integers, start: int) -> None:
    """Arbitration: of the controllers' oldest frames the smallest key wins."""
    best = -1
    for i in range(state[PENDING]):
        if frames[i, DUE] > start:
            continue
        oldest = True
        for j in range(i):
            if frames[j, PORT] == frames[i, PORT]:
                oldest = False
                break
        if not oldest:
            continue
        if (
            best < 0
            or frames[i, KEY] < frames[best, KEY]
            or (frames[i, KEY] == frames[best, KEY] and frames[i, PORT] < frames[best, PORT])
        ):
            best = i
    frames[_FLIGHT] = frames[best]
    state[PENDING] -= 1
    for i in range(best, state[PENDING]):
        frames[i] = frames[i + 1]
    state[FLYING] = 1


@njit("void(int64[::1], int64[:, ::1], int64[:, ::1])", cache=True)
def land(state: Integers, frames: Integers, delivered: Integers) -> None:
    """The frame on the wire has ended, and hosts may have it."""
    row = delivered[state[DELIVERED]]
    row[0] = state[END]
    row[1] = frames[_FLIGHT, IDENTIFIER] | frames[_FLIGHT, DLC] << 32
    row[2] = frames[_FLIGHT, DATA]
    row[SENDER] = frames[_FLIGHT, PORT]
    row[SPAN] = state[END] - frames[_FLIGHT, DUE]
    state[DELIVERED] += 1
    state[FLYING] = 0


@njit(
    "int64(int64[::1], int64[:, ::1], int64[:, ::1], int64[::1], int64[:, ::1], int64[::1], int64)",
    cache=True,
)
def run_wire(
    state: Integers,
    frames: Integers,
    delivered: Integers,
    kinds: Integers,
    held: Integers,
    durations: Integers,
    to_ns: int,
) -> int:
    """``kinds``: (2048,) by identifier; ``held``: a column for each held frame; ``durations``: ns
    by bits. Where it has stopped the frame is still on the wire."""
    while True:
        if not state[FLYING]:
            start = _start_ns(state, frames)
            state[NEXT] = start
            if start >= to_ns:
                return DONE
            _take_off(state, frames, start)
            flight = frames[_FLIGHT]
            value = _big_endian(flight[DATA], flight[DLC])
            length = durations[stuffed_bits(flight[IDENTIFIER], flight[DLC], value)]
            state[END] = start + length
            state[FREE] = state[END] + state[GAP]
            state[BUSY] += length + state[GAP]
            state[FRAMES] += 1
        state[NEXT] = state[END]
        if state[END] > to_ns:
            return DONE
        kind = kinds[frames[_FLIGHT, IDENTIFIER]]
        hold = kind - HELD
        if kind == STOPS or (hold >= 0 and frames[_FLIGHT, DLC] < held[LEAST, hold]):
            if frames[_FLIGHT, IDENTIFIER] == state[SYNC] and frames[_FLIGHT, DLC] == 0:
                state[WIDE] = state[END]
                return DONE
            return _STOPPED
        if state[DELIVERED] == delivered.shape[0]:
            return _FULL
        if hold >= 0:
            held[WAITS, hold] = frames[_FLIGHT, DLC]
            held[HELD_DATA, hold] = frames[_FLIGHT, DATA]
        land(state, frames, delivered)


@njit(
    "int64(int64[:, ::1], int64[:, :, ::1], int64[:, :, ::1], int64[:, ::1], int64[:, :, ::1],"
    " int64[:, ::1], int64, int64)",
    cache=True,
)
def run_wires(
    states: Integers,
    frames: Integers,
    delivered: Integers,
    kinds: Integers,
    held: Integers,
    durations: Integers,
    first: int,
    to_ns: int,
) -> int:
    """Let time pass on each wire from row ``first`` on. Returns the first row whose channel has to
    do it itself, or their number."""
    rows: int = states.shape[0]
    for row in range(first, rows):
        state = states[row]
        if state[WIDE] <= to_ns:
            continue
        if not state[ON]:
            return row
        if state[WIDE] != NEVER or to_ns < state[NEXT]:
            continue
        code = run_wire(
            state, frames[row], delivered[row], kinds[row], held[row], durations[row], to_ns
        )
        if code != DONE:
            return row
    return rows


@njit(cache=True)
def put_joined(
    states: Integers,
    waiting: Integers,
    rows: Integers,
    ports: Integers,
    frames: NDArray[np.void],
    now_ns: int,
) -> bool:
    """Let data frames of base identifiers, (n,) of `FRAMES`, enter their queues now, one after the
    other: those of channel c in row ``rows[c]``, sent by port ``ports[c]``. False: they do not all
    fit, and none has."""
    for channel in range(rows.shape[0]):
        state, count = states[rows[channel]], 0
        for i in range(frames.shape[0]):
            count += frames[i].channel == channel
        if count and (not state[ON] or state[PENDING] + count > state[MOST]):
            return False
    for i in range(frames.shape[0]):
        frame = frames[i]
        row = rows[frame.channel]
        state = states[row]
        place = waiting[row, state[PENDING]]
        place[DUE] = now_ns
        place[PORT] = ports[frame.channel]
        place[KEY] = np.int64(frame.identifier) << BASE_SHIFT
        place[IDENTIFIER] = frame.identifier
        place[DLC] = frame.dlc
        place[DATA] = frame.data
        state[PENDING] += 1
        if not state[FLYING] and now_ns < state[NEXT]:
            state[NEXT] = max(now_ns, state[FREE])
    return True


@njit("int64(int64[:, ::1])", cache=True)
def first_wide(states: Integers) -> int:
    """The row whose frame waits for the lab for longest, of equal ones the first; -1: none."""
    best, when = -1, NEVER
    for row in range(states.shape[0]):
        if states[row, WIDE] < when:
            best, when = row, int(states[row, WIDE])
    return best


@njit("int64(int64[:, ::1], int64, int64, boolean, int64[:, ::1], int64)", cache=True)
def _for_host(
    delivered: Integers, count: int, port: int, echo: bool, rows: Integers, at: int
) -> int:
    """What a host receives of ``delivered``, as rows of an inbox from row ``at`` on; the row
    behind them."""
    taken = at
    for i in range(count):
        own = delivered[i, SENDER] == port
        if own and not echo:
            continue
        rows[taken, 0] = delivered[i, 0]
        rows[taken, 1] = delivered[i, 1] | int(own) << 40
        rows[taken, 2] = delivered[i, 2]
        taken += 1
    return taken


class Host(Protocol):
    """A controller that receives."""

    @property
    def number(self) -> int: ...
    @property
    def echo(self) -> bool:
        """Whether it receives what it sent itself."""


class WireTable:
    """Wires that compiled code runs together: a row for each. ``bits``: how many lengths of a frame
    there are."""

    def __init__(self, rows: int, bits: int) -> None:
        self.states = np.zeros((rows, _STATE), np.int64)
        self.states[:, WIDE] = NEVER
        self._words: memoryview[int] = self.states.reshape(-1).data
        self.frames = np.zeros((rows, _SIZE, _COLUMNS), np.int64)
        self.delivered = np.zeros((rows, _SIZE, SPAN + 1), np.int64)
        self.kinds = np.zeros((rows, BASE_ID + 1), np.int64)
        self.held = np.zeros((rows, 3, ROOM), np.int64)
        self.durations = np.zeros((rows, bits), np.int64)
        self.answers = np.zeros((rows, ROOM, DATA + 2), np.int64)
        """of the plan, as the other two: what answers a SYNC,"""
        self.fields = np.zeros((rows, ROOM * _PLACES, 3), np.int64)
        """what the answers consist of,"""
        self.set_points = np.zeros((rows, ROOM, 3), np.int64)
        """and what the held frames bring"""

    def run(self, first: int, to_ns: int) -> int:
        """`run_wires` on this table."""
        row: int = run_wires(
            self.states,
            self.frames,
            self.delivered,
            self.kinds,
            self.held,
            self.durations,
            first,
            to_ns,
        )
        return row

    def put(self, rows: Integers, ports: Integers, frames: NDArray[np.void], now_ns: int) -> bool:
        """`put_joined` on this table."""
        taken: bool = put_joined(self.states, self.frames, rows, ports, frames, now_ns)
        return taken

    def waiting(self) -> tuple[int, int]:
        """The row whose frame waits for the lab for longest, and since when."""
        row: int = first_wide(self.states)
        return row, self._words[row * _STATE + WIDE] if row >= 0 else NEVER


class RegularWire:
    """The wire of one channel. ``durations``: ns of a frame by its bits; ``room``: how many frames
    may wait, `ROOM` at most."""

    def __init__(self, durations: list[int], gap_ns: int, room: int) -> None:
        self._rows = np.zeros((_SIZE, WORDS), np.int64)
        self._sit(WireTable(1, len(durations)), 0)
        self.durations[:] = durations
        self.state[GAP], self.state[MOST] = gap_ns, room
        self._room = room

    def _sit(self, table: WireTable, row: int) -> None:
        self.table, self.row = table, row
        self.state: Integers = table.states[row]
        self.frames: Integers = table.frames[row]
        self.delivered: Integers = table.delivered[row]
        self.kinds: Integers = table.kinds[row]
        self.held: Integers = table.held[row]
        self.durations: Integers = table.durations[row]
        self.answers: Integers = table.answers[row]
        self.fields: Integers = table.fields[row]
        self.set_points: Integers = table.set_points[row]
        # Python reads and writes single words of a memoryview in a third of an array's time.
        self.words: memoryview[int] = self.state.data
        self._frame_words: memoryview[int] = self.frames.reshape(-1).data
        self._memory = self.frames.reshape(-1).view(np.uint8).data

    def move(self, table: WireTable, row: int) -> None:
        """Into a row of another table, with all that is here."""
        for theirs, ours in (
            (table.states, self.state),
            (table.frames, self.frames),
            (table.delivered, self.delivered),
            (table.kinds, self.kinds),
            (table.held, self.held),
            (table.durations, self.durations),
            (table.answers, self.answers),
            (table.fields, self.fields),
            (table.set_points, self.set_points),
        ):
            theirs[row] = ours
        self._sit(table, row)

    def begin(self, free_ns: int) -> None:
        """An idle wire, free from ``free_ns`` on."""
        self.state[: NEXT + 1] = 0
        self.state[FREE], self.state[NEXT] = free_ns, NEVER
        self.state[ON] = 1

    def end(self) -> None:
        """The channel has the frames again."""
        self.state[ON] = 0

    def fits(self, count: int) -> bool:
        """Whether so many more frames may wait."""
        return self.words[PENDING] + count <= self._room

    @property
    def ready(self) -> bool:
        """Whether a SYNC waits here to be delivered, and its answers fit."""
        words = self.words
        return (
            words[FLYING] != 0
            and words[PENDING] + words[ANSWERS] <= words[MOST]
            and words[DELIVERED] < ROOM
        )

    @property
    def flying(self) -> int:
        """Identifier of the frame on the wire."""
        return int(self.frames[_FLIGHT, IDENTIFIER])

    @property
    def delivered_frames(self) -> int:
        """Frames that hosts may have."""
        return self.words[DELIVERED]

    def put(self, port: int, key: int, identifier: int, data: bytes, due_ns: int) -> bool:
        """Let a data frame of base identifier enter its queue then; False: it takes an object."""
        words = self.words
        pending = words[PENDING]
        if not words[ON] or identifier > BASE_ID or pending >= self._room:
            return False
        _ROW.pack_into(
            self._memory, pending * _ROW.size, due_ns, port, key, identifier, len(data), data
        )
        words[PENDING] = pending + 1
        if not words[FLYING] and due_ns < words[NEXT]:
            free_ns = words[FREE]
            words[NEXT] = due_ns if due_ns > free_ns else free_ns  # noqa: FURB136 - in half the time
        return True

    def run(self, to_ns: int) -> int:
        """Let time pass, at most to a SYNC, which waits for the lab. Returns `NEVER`, or when a
        frame ended that others have to deliver; 0 if there is no room for more that are
        delivered."""
        if to_ns < self.words[NEXT]:
            return NEVER
        code = run_wire(
            self.state,
            self.frames,
            self.delivered,
            self.kinds,
            self.held,
            self.durations,
            to_ns,
        )
        if code == DONE:
            return NEVER
        return self.words[END] if code == _STOPPED else 0

    def next_ns(self) -> int:
        """When something happens next by itself, or `NEVER`."""
        return self.words[NEXT]

    def hand_out(self, hosts: Iterable[tuple[Host, Inbox]], latency: Latency | None) -> None:
        """Let every host have what it receives of the delivered frames, and count their times."""
        count = self.words[DELIVERED]
        if not count:
            return
        delivered, spare = self.delivered, self._rows
        if latency is not None:
            latency.add_rows(delivered, count, SPAN)
        for host, inbox in hosts:
            number, echo = host.number, host.echo
            if inbox.holds(count):
                inbox.end = _for_host(delivered, count, number, echo, inbox.rows, inbox.end)
            else:
                inbox.extend(spare[: _for_host(delivered, count, number, echo, spare, 0)])
        self.words[DELIVERED] = 0

    def waiting(self, port: int) -> int:
        """Frames in a controller's queue."""
        # Without an array: asked for every frame that a client sends, and mostly few wait.
        senders = self._frame_words[PORT : self.words[PENDING] * _COLUMNS : _COLUMNS]
        return senders.tolist().count(port)

    def frame(self, row: int = _FLIGHT) -> tuple[Frame, int]:
        """A row as a frame, with its controller's number; by default that on the wire."""
        due_ns, port, key, identifier, dlc, data = self.frames[row].tolist()
        made = Frame(identifier, data.to_bytes(8, "little", signed=True)[:dlc], dlc, key)
        made.queued_ns = due_ns
        return made, port
