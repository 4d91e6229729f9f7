"""Whether only the daemon's processor is kept from idling, or all: measured, because hosts differ.

A hypervisor with many guests gives a processor that idles to another guest, and gives it back late.
One that allots a share of itself to each guest stops one whose processors never idle.
"""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from statistics import fmean, median
from typing import Literal

from tonus.runtime.timing.clock import pause, wall_seconds

Choice = Literal["own", "all"]
Undo = Callable[[], object]
_TURNS = 3
_ROUNDS = 100
_PERIOD_S = 1e-3
_LATE_US = 100.0
_CLEARLY = 2.0
"""All are kept awake if answers are late otherwise, and come so much sooner then."""


@dataclass(frozen=True)
class Comparison:
    """Mean time from the daemon's processor to another and back, us."""

    own_us: float
    all_us: float

    @property
    def better(self) -> Choice:
        return "all" if self.own_us > max(_LATE_US, _CLEARLY * self.all_us) else "own"

    def __str__(self) -> str:
        where = "all processors" if self.better == "all" else "the daemon's processor only"
        return (
            f"another processor answers within {self.own_us:.0f} us with idle states, "
            f"{self.all_us:.0f} us without: disabled on {where}"
        )


def compare(daemon: int, other: int, hold: Callable[[Choice], Undo | None]) -> Comparison:
    """Each choice held for some tenths of a second, in turns, and undone. The median of the turns
    keeps one stall from deciding."""
    usual = os.sched_getaffinity(0)
    near, far = socket.socketpair()
    echo = threading.Thread(target=_echo, args=(far, other), daemon=True)
    took: dict[Choice, list[float]] = {"own": [], "all": []}
    try:
        os.sched_setaffinity(0, {daemon})
        echo.start()
        for _ in range(_TURNS):
            for choice, means in took.items():
                undo = hold(choice)
                try:
                    means.append(fmean(_round(near) for _ in range(_ROUNDS)))
                finally:
                    if undo is not None:
                        undo()
    finally:
        os.sched_setaffinity(0, usual)
        near.close()
        echo.join()
        far.close()
    return Comparison(median(took["own"]), median(took["all"]))


def _round(near: socket.socket) -> float:
    pause(_PERIOD_S)
    began = wall_seconds()
    near.send(b"\0")
    near.recv(1)
    return (wall_seconds() - began) * 1e6


def _echo(far: socket.socket, processor: int) -> None:
    os.sched_setaffinity(0, {processor})  # of this thread
    while asked := far.recv(1):
        far.send(asked)
