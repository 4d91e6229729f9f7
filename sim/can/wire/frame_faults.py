"""What can be done to single frames, and a controller that sends without pause."""

from __future__ import annotations

from typing import Protocol

from tonus.config.schema.faults import Corruption, Delay, Duplicate, Loss
from tonus.sim.can.wire.frame import REMOTE, Frame
from tonus.sim.can.wire.port import Port


class Draws(Protocol):
    """A stream of random numbers; numpy's generators are."""

    def random(self) -> float: ...


class FrameFault:
    """A fault of frames at work. It draws for every frame that it is about, and for no other."""

    def __init__(self, fault: Loss | Corruption | Delay | Duplicate, draws: Draws) -> None:
        self.fault = fault
        self.played = 0
        """frames it has happened to"""
        self._draws = draws

    @property
    def spent(self) -> bool:
        return self.fault.frames is not None and self.played >= self.fault.frames

    def strikes(self, frame: Frame) -> bool:
        """Whether it happens to this frame; counts it."""
        wanted = self.fault.identifier
        if self.spent or (wanted is not None and frame.identifier & ~REMOTE != wanted):
            return False
        if self._draws.random() >= self.fault.probability:
            return False
        self.played += 1
        return True

    def fraction(self) -> float:
        """Where in the frame it happens, 0 to 1."""
        return self._draws.random()


class Copy(Frame):
    """A frame sent again by a `Duplicate`, which is not duplicated once more. The host has handed
    it over once, and is told of it once."""

    __slots__ = ()
    echoed = False

    def __init__(self, frame: Frame) -> None:
        super().__init__(frame.identifier, frame.data, frame.dlc, frame.key)
        self.queued_ns = frame.queued_ns


class Babbler:
    """Keeps one frame in a controller's queue, ``period_ns`` after the one before."""

    _DATA = b"\x55" * 8

    def __init__(self, port: Port, identifier: int, period_ns: int, now_ns: int) -> None:
        self.port = port
        self._identifier = identifier
        self._period_ns = period_ns
        self._due_ns = now_ns - period_ns

    def next(self, now_ns: int) -> tuple[int, Frame]:
        """The next frame and its time, once the last has been sent."""
        self._due_ns = max(now_ns, self._due_ns + self._period_ns)
        return self._due_ns, Frame(self._identifier, self._DATA)
