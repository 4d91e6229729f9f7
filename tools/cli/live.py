"""The live line of a run: state, stiffness, tensions, misses, time left.

Paced by run time, so that it costs the same per cycle in real and in virtual time and reads no
clock of its own. On a terminal one line is rewritten, `control.rates.status_divisor` ticks apart;
elsewhere one line a second is printed.
"""

from __future__ import annotations

import sys
from typing import TextIO

import numpy as np
from rich.console import Console
from rich.live import Live as Rewriting
from rich.text import Text

from tonus.runtime.signals import Grade
from tonus.runtime.states import State

_PLAIN_STEP_NS = 1_000_000_000
_STYLES = {Grade.GREEN: "green", Grade.AMBER: "yellow", Grade.RED: "bold red"}


class Live:
    """Shows cycle records as they come; `update` fits the recorder's ``watch``."""

    def __init__(self, duration_s: float, step_ns: int, stream: TextIO | None = None) -> None:
        """``duration_s`` of ACTIVE, to tell what is left; ``step_ns`` between terminal lines."""
        self._duration_s = duration_s
        self._console = Console(file=stream or sys.stdout, highlight=False, soft_wrap=True)
        self._rewriting: Rewriting | None = None
        if self._console.is_terminal:
            self._rewriting = Rewriting(console=self._console, auto_refresh=False, transient=True)
            self._rewriting.start()
        self._step_ns = step_ns if self._rewriting else _PLAIN_STEP_NS
        self._next_ns: int | None = None

    def update(self, record: np.void, stamp_ns: int) -> None:
        """Show a record of `tonus.runtime.signals.CYCLE`, unless one was shown a moment ago."""
        if self._next_ns is None:
            self._next_ns = stamp_ns
        if stamp_ns < self._next_ns:
            return
        self._next_ns += ((stamp_ns - self._next_ns) // self._step_ns + 1) * self._step_ns
        text = line(record, self._duration_s)
        if self._rewriting is not None:
            grade = Grade(int(record["envelope"]["grade"]))
            self._rewriting.update(Text(text, style=_STYLES[grade]), refresh=True)
        else:
            self._console.print(text, markup=False)

    def close(self) -> None:
        if self._rewriting is not None:
            self._rewriting.stop()


def line(record: np.void, duration_s: float) -> str:
    """One cycle record in one line for a person."""
    timing, state, tension = record["timing"], record["state"], record["tension"]["measured"]
    name = State(int(state["state"])).name
    left = max(duration_s - float(state["scenario_time"]), 0.0)
    return (
        f"{name:<11} K_eq {float(record['stiffness']['k_eq']):6.0f} N/m"
        f"  tension {float(tension.min()):6.1f} .. {float(tension.max()):6.1f} N"
        f"  missed {int(timing['missed_own'])} own {int(timing['missed_host'])} host"
        f"  left {left:5.1f} s"
    )
