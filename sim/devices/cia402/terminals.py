"""A drive's digital inputs and outputs: levels at the terminals, and the functions given to them.

A function's number is its bit in 0x60FD and 0x60FE.
"""

from __future__ import annotations

from enum import IntEnum

from tonus.sim.devices.objects import ObjectDictionary

UNUSED = 255
INPUTS = 8
"""Digital inputs 1 to 4, then high-speed inputs 1 to 4, as in 0x3142."""
OUTPUTS = 3
_STO_RELEASED = 3
"""0x3202: both channels have voltage"""
WIRES = {"negative_limit": 0, "positive_limit": 1, "home": 2, "quick_stop": 4, "drive_enable": 5}
"""Which input each wire goes to, as places in 0x3141; those of the switches suit the defaults of
0x3142, the other two do nothing until their inputs are given a function."""

TORQUE_OFF = ("sto", "sto_relay")
"""What can interrupt the wires of the safe torque off inputs: a fault, and the relay."""


class Function(IntEnum):
    NEGATIVE_LIMIT = 0
    POSITIVE_LIMIT = 1
    HOME = 2
    DRIVE_ENABLE = 27
    QUICK_STOP = 28


class Terminals:
    def __init__(self, objects: ObjectDictionary) -> None:
        self._objects = objects
        self._levels = 0
        self._without_voltage: set[str] = set()
        objects.find(0x3202, 1).read = lambda: 0 if self.torque_off else _STO_RELEASED
        objects.find(0x3141, 1).read = self.logic
        objects.find(0x60FD, 0).read = self.functions
        objects.find(0x3150, 1).read = self._outputs

    @property
    def torque_off(self) -> bool:
        """What the safe torque off inputs ask for."""
        return bool(self._without_voltage)

    def set_torque_off(self, wire: str, *, active: bool) -> None:
        """One of `TORQUE_OFF` takes the voltage of the safe torque off inputs, or has it back."""
        if active:
            self._without_voltage.add(wire)
        else:
            self._without_voltage.discard(wire)

    def set(self, wire: str, *, active: bool) -> None:
        """Raises KeyError for a wire there is not."""
        bit = 1 << WIRES[wire]
        self._levels = self._levels | bit if active else self._levels & ~bit

    def logic(self) -> int:
        """The inputs behind their polarity."""
        return self._levels ^ (self._objects.number(0x3141, 2) & (1 << INPUTS) - 1)

    def _places(self, function: int) -> list[int]:
        number = self._objects.number
        return [n for n in range(INPUTS) if number(0x3142, n + 1) == function]

    def has(self, function: Function) -> bool:
        """Whether an input has this function."""
        return bool(self._places(function))

    def active(self, function: Function) -> bool:
        logic = self.logic()
        return any(logic >> place & 1 for place in self._places(function))

    def functions(self) -> int:
        logic, word = self.logic(), 0
        for place in range(INPUTS):
            function = self._objects.number(0x3142, place + 1)
            if function != UNUSED and logic >> place & 1:
                word |= 1 << function
        return word

    def _outputs(self) -> int:
        number = self._objects.number
        wanted, word = number(0x60FE, 1), 0
        for place in range(OUTPUTS):
            function = number(0x3151, place + 1)
            if function != UNUSED and wanted >> (function & 31) & 1:
                word |= 1 << place
        return word ^ (number(0x3150, 2) & (1 << OUTPUTS) - 1)
