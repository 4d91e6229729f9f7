"""All devices at once and without frames: what `DirectFieldbus` exchanges its values with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tonus.sim.devices.cia402.drive import Cia402Drive
from tonus.sim.devices.force_cell import ForceCell
from tonus.sim.devices.samples import Samples

Integers = NDArray[np.int64]
Words = Sequence[int] | Integers


class Devices(Protocol):
    """The part of a lab that the port needs."""

    @property
    def drives(self) -> list[Cia402Drive]: ...
    @property
    def cells(self) -> list[ForceCell]: ...
    @property
    def samples(self) -> Samples: ...
    def advance(self, to_ns: int) -> None: ...


class Scale(Protocol):
    """What the port needs to know of the cells' configuration, whatever bus they hang on."""

    @property
    def decimal_digits(self) -> int: ...


class DirectPort:
    """Access to the devices in device units; process values are integers with decimal digits."""

    def __init__(self, lab: Devices, cell: Scale) -> None:
        self._lab = lab
        self._digits = bytes((cell.decimal_digits,))
        self._ready = False
        self._axes = np.arange(len(lab.drives))

    def exchange(
        self, at_ns: int, controlwords: Words, torques: Words
    ) -> tuple[Integers, Integers, Integers, Integers]:
        """At ``at_ns`` every device samples, then applies its controlword and torque (per mille).

        What a SYNC does on CAN. Returns statuswords, positions (increments) and torques (per
        mille) of all axes, and the process values of all cells, (n,) and (n + 1,).
        """
        lab = self._lab
        if not self._ready:
            self._ready = True
            for cell in lab.cells:
                for number in range(1, len(cell.cells) + 1):
                    cell.objects.write(0x6132, number, self._digits)
        lab.advance(at_ns)
        samples = lab.samples
        samples.at(at_ns)
        values = samples.values.copy()
        words, mille = np.asarray(controlwords), np.asarray(torques)
        for axis in samples.axes.apply(self._axes, words, mille):
            lab.drives[axis].target_torque(int(torques[axis]))
            lab.drives[axis].controlword(int(controlwords[axis]))
        return (
            values[samples.status : samples.error],
            values[: samples.torque],
            values[samples.torque : samples.cell],
            values[samples.cell : samples.validity],
        )

    def read(self, axis: int, index: int, subindex: int) -> bytes:
        """Raises `tonus.sim.devices.objects.AbortError`, a `LookupError`."""
        return self._lab.drives[axis].objects.read(index, subindex)

    def write(self, axis: int, index: int, subindex: int, data: bytes) -> None:
        """Raises `tonus.sim.devices.objects.AbortError`, a `LookupError`."""
        self._lab.drives[axis].objects.write(index, subindex, data)
