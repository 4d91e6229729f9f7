"""The faults found since the last reset: the first is the reason, all decide the usable cables."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tonus.runtime.states import Fault

if TYPE_CHECKING:
    from tonus.config.schema.robot import Robot

CABLE_GONE = frozenset(
    {
        Fault.DRIVE_LOST,
        Fault.DRIVE_FAULT,
        Fault.CELL_LOST,
        Fault.CELL_BAD,
        Fault.IMPLAUSIBLE_DRIVE,
        Fault.IMPLAUSIBLE_CELL,
        Fault.SLACK_CABLE,
        Fault.CABLE_TORN,
        Fault.LENGTH_JUMP,
        Fault.TENSION_ERROR,
        Fault.LENGTH_DRIFT,
        Fault.CELL_FROZEN,
        Fault.DRUM_TORQUE,
        Fault.DRUM_STUCK,
    }
)
"""Faults after which the cable they name is asked for nothing."""
PASSIVE = frozenset({Fault.NOT_FINITE})
"""Faults after which nothing that is computed may be relied on."""
_BY_CONTRADICTION = frozenset(
    {
        Fault.SLACK_CABLE,
        Fault.LENGTH_JUMP,
        Fault.TENSION_ERROR,
        Fault.LENGTH_DRIFT,
        Fault.CELL_FROZEN,
        Fault.DRUM_TORQUE,
        Fault.DRUM_STUCK,
    }
)
"""What is concluded from several measurements that do not agree."""
_CELL_UNKNOWN = frozenset(
    {Fault.CELL_LOST, Fault.CELL_BAD, Fault.IMPLAUSIBLE_CELL, Fault.CELL_FROZEN}
)
_ENCODER_UNKNOWN = frozenset({Fault.DRIVE_LOST, Fault.IMPLAUSIBLE_DRIVE, Fault.DRUM_STUCK})
_HELD = frozenset({Fault.DRIVE_LOST, Fault.DRIVE_FAULT, Fault.IMPLAUSIBLE_DRIVE, Fault.DRUM_STUCK})


class Faults:
    """The faults with their places, and the cables excluded by them."""

    def __init__(self, robot: Robot) -> None:
        self.found = np.zeros((len(Fault), robot.cells + 1), dtype=bool)
        """(fault, place + 1): whether it has been found there"""
        self.failed = np.zeros(robot.cables, dtype=bool)
        """(n,) cables that are not used any more"""
        self.freed = np.zeros(robot.cables, dtype=bool)
        """(n,) drums that stood against their torque when they were named, and turn since"""
        self.reset()

    def reset(self) -> None:
        """The operator says that the cause is removed."""
        self.first, self.where = Fault.NONE, -1
        self.count = 0
        self.found[:] = False
        self.failed[:] = self.freed[:] = False
        self.contradicted = False
        """a cable is excluded because measurements contradict each other: which of them is wrong,
        and whether another cable's is too, is less certain than of a torn cable or a silent drive
        """

    def add(self, fault: Fault, where: int, *, exclude: bool = True) -> bool:
        """Returns whether it is new. Without ``exclude`` the cable goes on pulling."""
        if fault is Fault.NONE or self.found[fault, where + 1]:
            return False
        self.found[fault, where + 1] = True
        self.count += 1
        if self.first is Fault.NONE:
            self.first, self.where = fault, where
        if exclude and fault in CABLE_GONE and 0 <= where < len(self.failed):
            self.contradicted |= fault in _BY_CONTRADICTION and not self.failed[where]
            self.failed[where] = True
        return True

    def at(self, fault: Fault, where: int) -> bool:
        """Just there."""
        return bool(self.found[fault, where + 1])

    def has(self, fault: Fault) -> bool:
        """Anywhere."""
        return bool(self.found[fault].any())

    def without(self, causes: frozenset[Fault]) -> NDArray[np.bool_]:
        """(n,) cables none of the ``causes`` was found at."""
        rows = self.found[[int(cause) for cause in causes], 1 : len(self.failed) + 1]
        return np.asarray(~rows.any(axis=0))

    @property
    def drums_trusted(self) -> NDArray[np.bool_]:
        """(n,) drums with a usable encoder."""
        return self.without(_ENCODER_UNKNOWN)

    @property
    def drums_readable(self) -> NDArray[np.bool_]:
        """(n,) drums whose encoder counts whenever its drive answers: one that was lost may be back
        within the same stop."""
        return self.without(_ENCODER_UNKNOWN - {Fault.DRIVE_LOST})

    @property
    def drums_obedient(self) -> NDArray[np.bool_]:
        """(n,) drums that do what their torque says: with a reversed motor damping would drive.
        One that stood is not reversed: once it turns, what had jammed it has let go."""
        return self.without(frozenset({Fault.DRUM_TORQUE})) | self.freed

    @property
    def torn(self) -> NDArray[np.bool_]:
        """(n,) drums whose cable counts as torn: they must not reel in."""
        return ~self.without(frozenset({Fault.CABLE_TORN}))

    @property
    def damping(self) -> NDArray[np.bool_]:
        """(n,) excluded cables whose drums and cells are sound, though what they say together is
        not: in a descent each of these drums is its own passive stop."""
        sound = self.drums_trusted & self.drums_obedient & self.without(_HELD) & ~self.torn
        return self.failed & sound & self.cells_trusted

    @property
    def held(self) -> NDArray[np.bool_]:
        """(n,) excluded cables whose drive may hold its drum, and whose encoder and cell count."""
        return self.failed & ~self.without(_HELD) & self.drums_trusted & self.cells_trusted

    @property
    def let_go(self) -> NDArray[np.bool_]:
        """(n,) excluded cables whose drum turns freely: their tension falls to zero."""
        return self.failed & self.without(_HELD) & ~self.damping

    @property
    def cells_trusted(self) -> NDArray[np.bool_]:
        """(n,) cables with a usable cell."""
        return self.without(_CELL_UNKNOWN)
