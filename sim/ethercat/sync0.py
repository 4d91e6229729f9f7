"""SYNC0 of a segment on which all is as usual: every input latched and every output applied at
once, with the effect that `Slave.latch` and `Slave.pulse` have slave by slave.

There is a plan where every slave at whose SYNC0 it is made is in OP, its inputs stand in
`Samples.values`, and its outputs are a controlword and a target torque of a drive, or none.
"""

from __future__ import annotations

from collections.abc import Sequence
from struct import Struct

import numpy as np

from tonus.sim.devices.samples import Samples
from tonus.sim.ethercat.slaves.clock import ClockTable
from tonus.sim.ethercat.slaves.slave import Slave
from tonus.sim.ethercat.slaves.states import State

_SET_POINT = "Hh"


class Sync0Plan:
    """It holds as long as no slave enters another state."""

    def __init__(
        self,
        slaves: Sequence[Slave],
        places: Sequence[int],
        samples: Samples,
        clocks: ClockTable,
    ) -> None:
        """``places`` of all inputs, one slave behind the other."""
        self._slaves = slaves
        self._clocks = clocks
        self._rows = np.array([slave.number - 1 for slave in slaves], np.int64)
        self._samples = samples
        self._places = np.array(places)
        layout = Struct("<" + "".join(slave.process_data.letters for slave in slaves))
        self._pack_into = layout.pack_into
        self._image = bytearray(layout.size)
        self._areas: list[tuple[memoryview, memoryview]] = []
        """where masters read each slave's inputs, and the same in the image"""
        at = 0
        for slave in slaves:
            area = slave.input_area
            self._areas.append((area, memoryview(self._image)[at : at + len(area)]))
            at += len(area)
        self._driven = [slave for slave in slaves if slave.process_data.is_set_point]
        self._unpack = Struct("<" + _SET_POINT * len(self._driven)).unpack
        self._axes = np.array([slave.device.axis for slave in self._driven], np.int64)

    def __call__(self, now_ns: int) -> None:
        samples = self._samples
        samples.at(now_ns)
        self._pack_into(self._image, 0, *samples.values[self._places].tolist())
        for area, inputs in self._areas:
            area[:] = inputs
        for slave in self._driven:
            if not slave.fresh:
                self._one_by_one(now_ns)
                return
        self._clocks.pulse(self._rows)
        outputs = [slave.take() for slave in self._driven]
        taken = np.array(self._unpack(b"".join(outputs)), np.int64)
        for place in samples.axes.apply(self._axes, taken[::2], taken[1::2]):
            self._driven[place].process_data.apply(outputs[place], now_ns)

    def _one_by_one(self, now_ns: int) -> None:
        """Not all outputs have come."""
        for slave in self._slaves:
            slave.pulse(now_ns)


def plan(slaves: Sequence[Slave], samples: Samples, clocks: ClockTable) -> Sync0Plan | None:
    """The plan of the slaves whose SYNC0 it is, as they are now; None: they have to be asked one by
    one. ``clocks`` of their segment."""
    places: list[int] = []
    for slave in slaves:
        data = slave.process_data
        drives = data.is_set_point and slave.device.axis is not None
        if slave.state is not State.OP or not (drives or not slave.kind.outputs):
            return None
        for place in data.places:
            if place is None:
                return None
            places.append(place)
    return Sync0Plan(slaves, places, samples, clocks) if places else None
