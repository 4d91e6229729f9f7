"""PDOs against the exchange: decoders and encoders compiled once from the mapping."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from drivers import epos4, force_cell
from drivers.canopen.channel import Handler
from drivers.canopen.pdo import Mapping, PdoError
from drivers.canopen.syncs import Arrival
from drivers.events import EventLog
from drivers.exchange import Exchange

Encode = Callable[[int, int], bytes]
"""(controlword, target torque in per mille) to the data of an RPDO."""


class Refusal:
    """Tells of a PDO whose length is not that of its mapping: its sender is not configured as we
    believe, so none of it is used."""

    def __init__(self, size: int, events: EventLog, where: str) -> None:
        self._size = size
        self._events = events
        self._where = where

    def __call__(self, length: int) -> None:
        name = "short_pdo" if length < self._size else "long_pdo"
        text = f"PDO of {length} bytes, mapped are {self._size}"
        self._events.counted(name, self._where, text)


def drive_decoder(
    mapping: Mapping, row: int, exchange: Exchange, arrival: Arrival, refuse: Refusal
) -> Handler:
    """Raises `PdoError` if the mapping lacks what control needs."""
    unpack = mapping.layout.unpack
    size = mapping.layout.size
    status_at = mapping.position(epos4.STATUSWORD)
    position_at = mapping.position(epos4.POSITION_ACTUAL)
    torque_at = mapping.position(epos4.TORQUE_ACTUAL)
    statuswords, positions, torques = exchange.statuswords, exchange.positions, exchange.torques
    book = arrival.book

    def decode(data: bytes) -> None:
        if len(data) != size:
            refuse(len(data))
        elif book(data):
            values = unpack(data)
            statuswords[row] = values[status_at]
            positions[row] = values[position_at]
            torques[row] = values[torque_at]

    return decode


def cell_decoder(
    mapping: Mapping, rows: Sequence[int], exchange: Exchange, arrival: Arrival, refuse: Refusal
) -> Handler:
    """``rows`` is the cell on each channel of the amplifier. Raises `PdoError` if the mapping lacks
    a channel's process value."""
    unpack = mapping.layout.unpack
    size = mapping.layout.size
    places = []
    for channel, row in enumerate(rows, start=1):
        values_of = [force_cell.of_channel(entry, channel) for entry in force_cell.PROCESS_VALUES]
        found = [entry for entry in values_of if entry in mapping.entries]
        if not found:
            raise PdoError(f"the force cell's TPDO maps no process value of channel {channel}")
        status = force_cell.of_channel(force_cell.STATUS, channel)
        places.append(
            (
                row,
                mapping.position(found[0]),
                mapping.position(status) if status in mapping.entries else None,
            )
        )
    cells, states = exchange.cells, exchange.cell_status
    book = arrival.book

    def decode(data: bytes) -> None:
        if len(data) != size:
            refuse(len(data))
        elif book(data):
            values = unpack(data)
            for row, value_at, status_at in places:
                cells[row] = values[value_at]
                if status_at is not None:
                    states[row] = values[status_at]

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
