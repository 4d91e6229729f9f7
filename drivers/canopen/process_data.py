"""PDOs against the exchange: what stands where in them, made once from the mapping."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tonus.drivers.canopen.reception import Field, doubt_field, mapped, tick_field, time_field
from tonus.drivers.cia301.pdo import Mapping, PdoError
from tonus.drivers.devices import drive, force_cell
from tonus.drivers.events import EventLog
from tonus.drivers.exchange import Exchange

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


def drive_fields(mapping: Mapping, row: int, exchange: Exchange) -> list[Field]:
    """Raises `PdoError` if the mapping lacks what control needs."""
    wanted = (
        (drive.STATUSWORD, exchange.statuswords),
        (drive.POSITION_ACTUAL, exchange.positions),
        (drive.TORQUE_ACTUAL, exchange.torques),
    )
    return [
        tick_field(exchange.place(exchange.axis_tick, row)),
        time_field(exchange.place(exchange.sampled_ns, row)),
        doubt_field(exchange.place(exchange.doubt_ns, row)),
        *(mapped(mapping, entry, exchange.place(column, row)) for entry, column in wanted),
    ]


def cell_fields(mapping: Mapping, rows: Sequence[int], exchange: Exchange) -> list[Field]:
    """``rows`` is the cell on each channel of the amplifier. Raises `PdoError` if the mapping lacks
    a channel's process value."""
    fields = []
    for channel, row in enumerate(rows, start=1):
        values_of = [force_cell.of_channel(entry, channel) for entry in force_cell.PROCESS_VALUES]
        found = [entry for entry in values_of if entry in mapping.entries]
        if not found:
            raise PdoError(f"the load cell's TPDO maps no process value of channel {channel}")
        fields.append(tick_field(exchange.place(exchange.cell_tick, row)))
        value = exchange.place(exchange.cells, row)
        fields.append(mapped(mapping, found[0], value, floating=True))
        status = force_cell.of_channel(force_cell.STATUS, channel)
        if status in mapping.entries:
            fields.append(mapped(mapping, status, exchange.place(exchange.cell_status, row)))
    return fields


def drive_encoder(mapping: Mapping) -> Encode:
    """Raises `PdoError` if the mapping lacks, or holds, what control cannot command."""
    pack = mapping.layout.pack
    mapping.position(drive.CONTROLWORD)
    mapping.position(drive.TARGET_TORQUE)
    if mapping.entries == (drive.CONTROLWORD, drive.TARGET_TORQUE):
        return pack
    known = (drive.CONTROLWORD, drive.TARGET_TORQUE, *drive.CONSTANTS)
    for entry in mapping.entries:
        if entry not in known:
            raise PdoError(f"the RPDO maps 0x{entry:08X}, which control does not command")
    return lambda controlword, torque: pack(*_values(mapping.entries, controlword, torque))


def _values(entries: Sequence[int], controlword: int, torque: int) -> list[int]:
    values = {**drive.CONSTANTS, drive.CONTROLWORD: controlword, drive.TARGET_TORQUE: torque}
    return [values[entry] for entry in entries]
