"""What happens to frames of a segment on purpose, decided for each frame by itself."""

from __future__ import annotations

from enum import Enum
from typing import Protocol

from tonus.config.schema.faults import Corruption, Delay, Duplicate, Loss

_READ, _WRITE = 1, 2
FrameFault = Loss | Corruption | Delay | Duplicate


class Draws(Protocol):
    """A stream of random numbers; numpy's generators are."""

    def random(self) -> float: ...


class Fate(Enum):
    """Of a frame."""

    PASSES = 0
    LOST = 1
    CORRUPTED = 2
    LATE = 3
    TWICE = 4


_FATES: dict[type, Fate] = {
    Loss: Fate.LOST,
    Corruption: Fate.CORRUPTED,
    Delay: Fate.LATE,
    Duplicate: Fate.TWICE,
}


class Played:
    """A fault of the schema at work. It draws for every frame, until it is spent."""

    def __init__(self, fault: FrameFault, draws: Draws) -> None:
        self.fault = fault
        self.played = 0
        self._draws = draws

    @property
    def spent(self) -> bool:
        return self.fault.frames is not None and self.played >= self.fault.frames

    def strikes(self) -> bool:
        if self.spent or self._draws.random() >= self.fault.probability:
            return False
        self.played += 1
        return True


class Disturbance:
    """The plain orders of a test, and the schema's faults of frames.

    ``drop`` frames are lost next; each is with probability ``drop_p``; all while ``mute``.
    ``drop_mbx`` and ``drop_mbxw`` answers to reads and writes of a mailbox are lost: the slave has
    acted, the master does not know.
    """

    def __init__(self) -> None:
        self.drop = 0
        self.drop_p = 0.0
        self.mute = False
        self.drop_mbx = 0
        self.drop_mbxw = 0
        self.draws: Draws | None = None
        self.delay_ns = 0
        """of the last frame that is late"""
        self.where = 0
        """place of the slave behind the bad cable"""
        self._faults: list[Played] = []
        self.active = False

    def changed(self) -> None:
        """Look whether anything is left to do; a quiet segment is not slowed down."""
        self._faults = [played for played in self._faults if not played.spent]
        orders = self.drop, self.drop_p, self.mute, self.drop_mbx, self.drop_mbxw
        self.active = any(orders) or bool(self._faults)

    def add(self, played: Played) -> None:
        self._faults.append(played)
        self.changed()

    def remove(self, played: Played) -> None:
        if played in self._faults:
            self._faults.remove(played)
        self.changed()

    def fate(self) -> Fate:
        """What happens to the next frame."""
        fate = self._fate()
        self.changed()
        return fate

    def _fate(self) -> Fate:
        if self.mute:
            return Fate.LOST
        if self.drop:
            self.drop -= 1
            return Fate.LOST
        if self.drop_p and self.draws is not None and self.draws.random() < self.drop_p:
            return Fate.LOST
        for played in self._faults:
            if played.strikes():
                if isinstance(played.fault, Delay):
                    self.delay_ns = played.fault.delay_us * 1000
                return _FATES[type(played.fault)]
        return Fate.PASSES

    def takes_answer(self, mail: int) -> bool:
        """Whether the answer of a frame that carried mail is lost."""
        taken = False
        if mail & _READ and self.drop_mbx:
            self.drop_mbx -= 1
            taken = True
        elif mail & _WRITE and self.drop_mbxw:
            self.drop_mbxw -= 1
            taken = True
        self.changed()
        return taken
