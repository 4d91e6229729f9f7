"""What control sees of every bus: two structured arrays in SI units, one row per axis or cell."""

from __future__ import annotations

import zlib
from enum import IntEnum
from types import SimpleNamespace

import numpy as np

from tonus.config.schema.robot import cells_of

NEVER = np.iinfo(np.uint16).max
"""Age of a measurement that has not arrived yet, in ticks."""

AXIS_INPUT = np.dtype(
    [
        ("angle", "f8"),  # rad at the drum, incremental: zero is where the drive was switched on
        ("torque", "f8"),  # N m at the drum, the drive's own figure, before gearbox losses
        ("sampled_ns", "i8"),  # when the SYNC or SYNC0 took the sample; 0: not known
        ("doubt_ns", "i8"),  # by how much that may be wrong
        ("statusword", "u2"),
        ("error_code", "u2"),  # of the last EMCY, 0 for none
        ("age", "u2"),  # ticks since the measurement's own tick
        ("state", "u1"),  # AxisState
    ],
    align=True,
)

CELL_INPUT = np.dtype(
    [
        ("force", "f8"),  # N, as the cell reports it, untared
        ("age", "u2"),
        ("status", "u1"),  # CiA 404 0x6150: 0 good
    ],
    align=True,
)

TRACKER_INPUT = np.dtype(
    [
        ("position", "f8", 3),
        ("quaternion", "f8", 4),  # w x y z
        ("delay", "f8"),  # s between the pose's timestamp and this tick's due time
        ("sequence", "u4"),
        ("fresh", "u1"),  # 1 in the one tick in which this pose arrived
    ],
    align=True,
)

AXIS_OUTPUT = np.dtype(
    [
        ("torque", "f8"),  # N m at the drum, before gearbox losses
        ("command", "u1"),  # AxisCommand
    ],
    align=True,
)


class AxisState(IntEnum):
    """CiA 402 states as control needs them; LOST is a drive that stopped answering."""

    LOST = 0
    NOT_READY = 1
    SWITCH_ON_DISABLED = 2
    READY_TO_SWITCH_ON = 3
    SWITCHED_ON = 4
    OPERATION_ENABLED = 5
    QUICK_STOP_ACTIVE = 6
    FAULT_REACTION_ACTIVE = 7
    FAULT = 8


class AxisCommand(IntEnum):
    """Where control wants an axis; the axis finds the way there, one transition at a time."""

    DISABLE = 0
    ENABLE = 1
    QUICK_STOP = 2
    RESET_FAULT = 3


_ENABLE = int(AxisCommand.ENABLE)


class ProcessImage:
    """The inputs a tick reads and the outputs it writes; arrays stay the same objects for life.

    The three tables of inputs lie one behind the other in one block of memory.
    """

    def __init__(self, cables: int) -> None:
        cells = cables * AXIS_INPUT.itemsize
        tracker = cells + cells_of(cables) * CELL_INPUT.itemsize
        end = tracker + TRACKER_INPUT.itemsize
        self._inputs = np.zeros(end // 8, np.uint64).view(np.uint8)
        self.axes = self._inputs[:cells].view(AXIS_INPUT)
        self.cells = self._inputs[cells:tracker].view(CELL_INPUT)
        self.tracker = self._inputs[tracker:].view(TRACKER_INPUT).reshape(())
        self.commands = np.zeros(cables, AXIS_OUTPUT)
        self.axis = SimpleNamespace(**{name: self.axes[name] for name in AXIS_INPUT.names or ()})
        self.cell = SimpleNamespace(**{name: self.cells[name] for name in CELL_INPUT.names or ()})
        self.torque, self.command = self.commands["torque"], self.commands["command"]
        """views of single columns, ready made: to make one takes as long as to use it"""
        self.bus_ns = 0
        """from the last exchange to its last answer, where the bus knows; no input of control"""
        self.unguarded = False
        """the supervisor could not take the torque of the drives: the relay's node is silent"""
        self.supervisor_ignored = False
        """its heartbeat has ended, and what should have stopped by itself has not"""
        self.obstacles: dict[str, str] = {}
        """what the bus has against arming, by what it is looked at; no input of control"""
        self.axes["age"] = NEVER
        self.cells["age"] = NEVER
        self.tracker["quaternion"] = (1.0, 0.0, 0.0, 0.0)

    @property
    def enabling(self) -> bool:
        """An axis is commanded to be enabled."""
        # As bytes: every comparison of numpy's with a number takes ten times as long.
        return _ENABLE in self.command.tobytes()

    def checksum(self, start: int) -> int:
        """CRC-32 of the inputs, continued from ``start``."""
        return zlib.crc32(self._inputs.data, start & 0xFFFFFFFF)
