"""PDOs against the exchange: decoders and encoders compiled once from the mapping."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from drivers import epos4, force_cell
from drivers.canopen.channel import Handler
from drivers.canopen.pdo import Mapping, PdoError
from drivers.events import EventLog
from drivers.exchange import NOT_YET, Exchange

Encode = Callable[[int, int], bytes]
"""(controlword, target torque in per mille) to the data of an RPDO."""


class SyncTicks:
    """In which tick the last SYNC went out, and the one before it."""

    __slots__ = ("before", "last")

    def __init__(self) -> None:
        self.last = NOT_YET
        self.before = NOT_YET

    def sent(self, tick: int) -> None:
        self.before, self.last = self.last, tick


class Arrival:
    """Books one node's TPDO to the SYNC it answers, and tells the irregular ones apart.

    A frame carries no tick. The first after a SYNC counts as its answer; one that comes when the
    previous answer was missing may be that answer, late, and is followed by the right one; a second
    without such a gap is a duplicate.
    """

    __slots__ = ("_events", "_gap", "_row", "_size", "_sync", "_ticks", "_where")

    def __init__(
        self, row: int, ticks: list[int], size: int, sync: SyncTicks, events: EventLog, where: str
    ) -> None:
        self._row = row
        self._ticks = ticks
        self._size = size
        self._sync = sync
        self._events = events
        self._where = where
        self._gap = False

    def book(self) -> None:
        tick = self._sync.last
        previous = self._ticks[self._row]
        if previous == self._sync.before:
            self._gap = False
        elif previous == tick:
            if self._gap:
                self._events.counted("late_pdo", self._where, "answer to an earlier SYNC")
            else:
                self._events.counted("duplicate_pdo", self._where, "second answer to one SYNC")
        elif previous != NOT_YET:
            self._gap = True
            self._events.counted("missing_pdo", self._where, "a SYNC went without an answer")
        self._ticks[self._row] = tick

    def short(self, length: int) -> None:
        text = f"PDO of {length} bytes, mapped are {self._size}; not used"
        self._events.counted("short_pdo", self._where, text)


def drive_decoder(
    mapping: Mapping, row: int, exchange: Exchange, sync: SyncTicks, events: EventLog, where: str
) -> Handler:
    """Raises `PdoError` if the mapping lacks what control needs."""
    unpack = mapping.layout.unpack_from
    size = mapping.layout.size
    status_at = mapping.position(epos4.STATUSWORD)
    position_at = mapping.position(epos4.POSITION_ACTUAL)
    torque_at = mapping.position(epos4.TORQUE_ACTUAL)
    statuswords, positions, torques = exchange.statuswords, exchange.positions, exchange.torques
    arrival = Arrival(row, exchange.axis_tick, size, sync, events, where)

    def decode(data: bytearray) -> None:
        if len(data) < size:
            arrival.short(len(data))
        elif sync.last != NOT_YET:
            values = unpack(data)
            statuswords[row] = values[status_at]
            positions[row] = values[position_at]
            torques[row] = values[torque_at]
            arrival.book()

    return decode


def cell_decoder(
    mapping: Mapping, row: int, exchange: Exchange, sync: SyncTicks, events: EventLog, where: str
) -> Handler:
    """Raises `PdoError` if the mapping lacks a process value."""
    found = [entry for entry in force_cell.PROCESS_VALUES if entry in mapping.entries]
    if not found:
        raise PdoError("the force cell's TPDO maps no process value of channel 1")
    unpack = mapping.layout.unpack_from
    size = mapping.layout.size
    value_at = mapping.position(found[0])
    status_at = (
        mapping.position(force_cell.STATUS) if force_cell.STATUS in mapping.entries else None
    )
    cells, status = exchange.cells, exchange.cell_status
    arrival = Arrival(row, exchange.cell_tick, size, sync, events, where)

    def decode(data: bytearray) -> None:
        if len(data) < size:
            arrival.short(len(data))
        elif sync.last != NOT_YET:
            values = unpack(data)
            cells[row] = values[value_at]
            if status_at is not None:
                status[row] = values[status_at]
            arrival.book()

    return decode


def drive_encoder(mapping: Mapping) -> Encode:
    """Raises `PdoError` if the mapping lacks, or holds, what control cannot command."""
    pack = mapping.layout.pack
    mapping.position(epos4.CONTROLWORD)
    mapping.position(epos4.TARGET_TORQUE)
    if mapping.entries == (epos4.CONTROLWORD, epos4.TARGET_TORQUE):
        return pack
    known = (epos4.CONTROLWORD, epos4.TARGET_TORQUE, *epos4.CONSTANTS)
    for entry in mapping.entries:
        if entry not in known:
            raise PdoError(f"the RPDO maps 0x{entry:08X}, which control does not command")
    return lambda controlword, torque: pack(*_values(mapping.entries, controlword, torque))


def _values(entries: Sequence[int], controlword: int, torque: int) -> list[int]:
    values = {**epos4.CONSTANTS, epos4.CONTROLWORD: controlword, epos4.TARGET_TORQUE: torque}
    return [values[entry] for entry in entries]
