"""The inputs of all slaves of a segment, taken apart by compiled code."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.drivers.canopen.process_data import cell_fields, drive_fields
from tonus.drivers.canopen.reception import FIELD, Field, mapped, store_field
from tonus.drivers.cia301.pdo import Mapping
from tonus.drivers.ethercat.slave import Slave
from tonus.drivers.exchange import NOT_YET, Exchange

_ERROR_CODE = 0x603F0010


@njit(cache=True)
def _take(
    data: NDArray[np.uint8],
    sampled: tuple[int, int, int],
    fields: NDArray[np.void],
    delivered: NDArray[np.bool_],
    integers: NDArray[np.int64],
    reals: NDArray[np.float64],
) -> None:
    for i in range(fields.shape[0]):
        if not delivered[i]:
            continue
        field = fields[i]
        value, first = np.int64(0), field.shift >> 3
        for byte in range(field.bits >> 3):
            value |= np.int64(data[first + byte]) << 8 * byte
        value = (value << (64 - field.bits)) >> (64 - field.bits)
        store_field(field, int(value), sampled, integers, reals)


class Inputs:
    """Takes them into an exchange."""

    def __init__(self, slaves: Sequence[Slave], exchange: Exchange) -> None:
        """Raises `PdoError` for a mapping that control cannot work with."""
        fields: list[Field] = []
        self._size = 0
        of_slave: list[int] = []
        for number, slave in enumerate(slaves):
            begin = 8 * self._size
            its = [field._replace(shift=begin + field.shift) for field in _fields(slave, exchange)]
            fields += its
            of_slave += [number] * len(its)
            self._size += slave.sizes.inputs
        self._fields = np.array(fields, FIELD)
        self._of_slave = np.array(of_slave, np.int64)
        self._delivers: Sequence[bool] = ()
        self._delivered = np.zeros(0, np.bool_)
        self._words = (exchange.integers, exchange.reals)
        # Compiles it before a tick needs it.
        self.take([bytes(self._size)], [True] * len(slaves), NOT_YET, 0, 0)

    def take(
        self,
        inputs: Sequence[bytes],
        delivers: Sequence[bool],
        tick: int,
        sampled_ns: int,
        doubt_ns: int,
    ) -> None:
        """Of each slave in its order, where ``delivers`` says that they are its own; all were
        sampled in ``tick``, at ``sampled_ns`` or up to ``doubt_ns`` later."""
        if delivers is not self._delivers:
            self._delivers = delivers
            self._delivered = np.array(delivers, np.bool_)[self._of_slave]
        data = np.frombuffer(b"".join(inputs), np.uint8, self._size)
        _take(data, (tick, sampled_ns, doubt_ns), self._fields, self._delivered, *self._words)


def _fields(slave: Slave, exchange: Exchange) -> list[Field]:
    """Raises `PdoError`."""
    mapping = Mapping.of(slave.tx)
    if slave.axis is None:
        return cell_fields(mapping, slave.cells, exchange)
    fields = drive_fields(mapping, slave.axis, exchange)
    if _ERROR_CODE in mapping.entries:
        place = exchange.place(exchange.error_codes, slave.axis)
        fields.append(mapped(mapping, _ERROR_CODE, place))
    return fields
