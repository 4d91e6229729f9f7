"""A SYNC on a channel of operational nodes, in compiled code: all samples out, all set-points in.

There is a plan where every node that hears the SYNC sends process data that stand in
`Samples.values`, in every cycle, and where the received ones are a controlword and a target torque
of a drive, or none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from tonus.sim.can.canopen.node import SYNC, Node
from tonus.sim.can.canopen.pdo import ReceivePdo, TransmitPdo
from tonus.sim.can.wire.channel import Channel
from tonus.sim.can.wire.regular import (
    ANSWERS,
    DATA,
    DELIVERED,
    DLC,
    DONE,
    DUE,
    FLYING,
    FREE,
    HELD,
    HELD_DATA,
    IDENTIFIER,
    KEY,
    LEAST,
    MOST,
    NEVER,
    NEXT,
    ON,
    PENDING,
    PLAIN,
    PORT,
    RESPONSE,
    ROOM,
    SET_POINTS,
    STOPS,
    WAITS,
    WIDE,
    Integers,
    RegularWire,
    WireTable,
    land,
    run_wire,
)
from tonus.sim.can.wire.regular import SYNC as SYNC_IDENTIFIER
from tonus.sim.devices.cia402.axis_table import Floats, follow
from tonus.sim.devices.samples import Samples

_SET_POINT = {0x60400010: 0, 0x60710010: 1}
"""Words of a mapping, and the place of each among what a set-point consists of."""
_FIRST, _FIELDS = DATA, DATA + 1
"""Columns of an answer, instead of a frame's data: its first field, and how many."""
_PLACE, _SHIFT, _MASK = range(3)
_AXIS, _WORD, _TORQUE = range(3)
_ITSELF = -1
"""The channel has to deliver the frame itself."""


@njit(cache=True)
def _signed(value: int) -> int:
    return (value & 0xFFFF) - ((value & 0x8000) << 1)


@njit(
    "int64(int64[::1], int64[:, ::1], int64[:, ::1], int64[:, ::1], int64, int64[:, ::1],"
    " int64[:, ::1], int64[::1], int64[:, ::1], int64[:, ::1], float64[:, ::1], float64[::1],"
    " int64[::1])",
    cache=True,
)
def _react(
    state: Integers,
    frames: Integers,
    delivered: Integers,
    held: Integers,
    now_ns: int,
    answers: Integers,
    fields: Integers,
    values: Integers,
    set_points: Integers,
    integers: Integers,
    currents: Floats,
    reference: Floats,
    left: Integers,
) -> int:
    """First all that is sent, then what was received before; how many set-points are left to their
    drives."""
    land(state, frames, delivered)
    state[WIDE] = NEVER
    for i in range(state[ANSWERS]):
        answer = answers[i]
        data = 0
        for field in range(answer[_FIRST], answer[_FIRST] + answer[_FIELDS]):
            place, shift, mask = fields[field]
            data |= (values[place] & mask) << shift
        row = frames[state[PENDING]]
        row[DUE] = now_ns + state[RESPONSE]
        row[PORT] = answer[PORT]
        row[KEY] = answer[KEY]
        row[IDENTIFIER] = answer[IDENTIFIER]
        row[DLC] = answer[DLC]
        row[DATA] = data
        state[PENDING] += 1
    state[NEXT] = state[FREE]
    count = 0
    for i in range(state[SET_POINTS]):
        if held[WAITS, i] == 0:
            continue
        data = held[HELD_DATA, i]
        word = (data >> set_points[i, _WORD]) & 0xFFFF
        torque = _signed(data >> set_points[i, _TORQUE])
        if follow(integers, currents, reference, set_points[i, _AXIS], word, torque):
            held[WAITS, i] = 0
        else:
            left[count] = i
            count += 1
    return count


@njit(
    "int64(int64[:, ::1], int64[:, :, ::1], int64[:, :, ::1], int64[:, ::1], int64[:, :, ::1],"
    " int64[:, ::1], int64[:, :, ::1], int64[:, :, ::1], int64[:, :, ::1], int64, int64,"
    " int64[::1], int64[:, ::1], float64[:, ::1], float64[::1], int64[::1])",
    cache=True,
)
def _react_all(
    states: Integers,
    frames: Integers,
    delivered: Integers,
    kinds: Integers,
    held: Integers,
    durations: Integers,
    answers: Integers,
    fields: Integers,
    set_points: Integers,
    now_ns: int,
    to_ns: int,
    values: Integers,
    integers: Integers,
    currents: Floats,
    reference: Floats,
    left: Integers,
) -> int:
    """Channel by channel, where a SYNC has ended now: `_react`, and let time pass up to ``to_ns``.
    Returns the number of rows, or the row where it stopped; then the end of ``left`` is how many
    set-points are left to their drives there, or `_ITSELF`."""
    rows: int = states.shape[0]
    for row in range(rows):
        state = states[row]
        if state[WIDE] != now_ns:
            continue
        if (
            not state[ON]
            or not state[FLYING]
            or state[PENDING] + state[ANSWERS] > state[MOST]
            or state[DELIVERED] >= ROOM
        ):
            left[-1] = _ITSELF
            return row
        count = _react(
            state,
            frames[row],
            delivered[row],
            held[row],
            now_ns,
            answers[row],
            fields[row],
            values,
            set_points[row],
            integers,
            currents,
            reference,
            left,
        )
        done = count == 0 and (
            to_ns < state[NEXT]
            or run_wire(
                state, frames[row], delivered[row], kinds[row], held[row], durations[row], to_ns
            )
            == DONE
        )
        if not done:
            left[-1] = count
            return row
    return rows


class NodesPlan:
    """The plan of one channel's nodes."""

    identifier = SYNC

    def __init__(
        self,
        channel: Channel,
        answers: Sequence[tuple[Node, TransmitPdo]],
        set_points: Sequence[tuple[Node, ReceivePdo]],
        samples: Samples,
    ) -> None:
        self.answers = len(answers)
        self._channel = channel
        self._samples = samples
        self._set_points = list(set_points)
        rows: list[tuple[int, ...]] = []
        fields: list[tuple[int | None, int, int]] = []
        for node, pdo in answers:
            dlc = sum(size for _, size in pdo.fields)
            key = pdo.identifier << 21
            rows.append(
                (0, node.port.number, key, pdo.identifier, dlc, len(fields), len(pdo.fields))
            )
            shift = 0
            for place, size in pdo.fields:
                fields.append((place, shift, (1 << 8 * size) - 1))
                shift += 8 * size
        self._answers = np.array(rows, np.int64).reshape(len(rows), DATA + 2)
        self._fields = np.array(fields, np.int64).reshape(len(fields), 3)
        table = [
            (node.device.axis, *(16 * pdo.words.index(word) for word in _SET_POINT))
            for node, pdo in set_points
        ]
        self._table = np.array(table, np.int64).reshape(len(table), 3)
        self._left = np.zeros(ROOM + 1, np.int64)

    def begin(self, wire: RegularWire) -> None:
        """Tell the wire its identifiers, and hand over what waits for the SYNC."""
        wire.kinds[:] = PLAIN
        for identifier in self._channel.subscribed:
            if identifier < len(wire.kinds):
                wire.kinds[identifier] = STOPS
        state = wire.state
        state[SYNC_IDENTIFIER], state[RESPONSE] = self.identifier, self._channel.response_ns
        state[ANSWERS], state[SET_POINTS] = self.answers, len(self._set_points)
        wire.answers[: self.answers] = self._answers
        wire.fields[: len(self._fields)] = self._fields
        wire.set_points[: len(self._table)] = self._table
        wire.held[:] = 0
        for number, (_, pdo) in enumerate(self._set_points):
            wire.kinds[pdo.identifier] = HELD + number
            wire.held[LEAST, number] = pdo.length
            if pdo.data is not None:
                wire.held[WAITS, number] = len(pdo.data)
                data = pdo.data.ljust(8, b"\0")
                wire.held[HELD_DATA, number] = int.from_bytes(data, "little", signed=True)
                pdo.data = None

    def end(self, wire: RegularWire) -> None:
        """Take back what waits for the SYNC."""
        for number, (_, pdo) in enumerate(self._set_points):
            pdo.data = self._take(wire, number)

    def _take(self, wire: RegularWire, number: int) -> bytes | None:
        length = int(wire.held[WAITS, number])
        wire.held[WAITS, number] = 0
        data = int(wire.held[HELD_DATA, number]).to_bytes(8, "little", signed=True)
        return data[:length] or None

    def react(self, wire: RegularWire, now_ns: int) -> None:
        """Deliver the SYNC that has ended now, and do what every device does at it."""
        samples, axes = self._samples, self._samples.axes
        samples.at(now_ns)
        count = _react(
            wire.state,
            wire.frames,
            wire.delivered,
            wire.held,
            now_ns,
            wire.answers,
            wire.fields,
            samples.values,
            wire.set_points,
            axes.integers,
            axes.currents,
            axes.reference,
            self._left,
        )
        self.follow(wire, self._left[:count].tolist(), now_ns)

    def follow(self, wire: RegularWire, left: list[int], now_ns: int) -> None:
        """Have drives apply the set-points that were left to them."""
        # A copy, and data taken at once: a drive may end the plan.
        waiting = [(number, self._take(wire, number)) for number in left]
        for number, data in waiting:
            node, pdo = self._set_points[number]
            assert data is not None
            pdo.apply(data)
            node.device.received(now_ns)


class Reaction:
    """Delivers a SYNC that has ended on several channels at one instant."""

    def __init__(self, samples: Samples) -> None:
        self._samples = samples
        self._left = np.zeros(ROOM + 1, np.int64)

    def __call__(self, table: WireTable, now_ns: int, to_ns: int) -> tuple[int, list[int] | None]:
        """Do what every device does at it, and let time pass up to ``to_ns``. Returns the row whose
        channel has to go on by itself, or the number of rows, and what set-points are left to their
        drives there; None: the SYNC is still to be delivered there."""
        samples, axes, left = self._samples, self._samples.axes, self._left
        samples.at(now_ns)
        row = _react_all(
            table.states,
            table.frames,
            table.delivered,
            table.kinds,
            table.held,
            table.durations,
            table.answers,
            table.fields,
            table.set_points,
            now_ns,
            to_ns,
            samples.values,
            axes.integers,
            axes.currents,
            axes.reference,
            left,
        )
        if row == len(table.states):
            return row, []
        return row, None if left[-1] == _ITSELF else left[: left[-1]].tolist()


def plan(channel: Channel, nodes: Sequence[Node], samples: Samples) -> NodesPlan | None:
    """The plan of a channel as it is now; None: its nodes need to be asked one by one."""
    hearing = [node for node in nodes if node.hears(SYNC)]
    if len(hearing) != channel.subscribers(SYNC):
        return None
    answers = [(node, pdo) for node in hearing for pdo in node.transmitted]
    set_points = [(node, pdo) for node in hearing for pdo in node.received if pdo.synchronous]
    if max(len(answers), len(set_points)) > ROOM:
        return None
    usual = all(pdo.rate == 1 and None not in dict(pdo.fields) for _, pdo in answers)
    usual = usual and all(
        node.device.axis is not None
        and sorted(pdo.words) == sorted(_SET_POINT)
        and channel.subscribers(pdo.identifier) == 1
        for node, pdo in set_points
    )
    return NodesPlan(channel, answers, set_points, samples) if usual else None
