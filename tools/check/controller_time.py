"""How long a controller of somebody else's takes in a tick, measured before it is let near a robot
in real time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tonus.config import Config
from tonus.runtime.timing.clock import Stopwatch
from tonus.tools.margins.probe import Probe

ROUNDS = 5
TICKS = 200
"""in a round"""
WARM_TICKS = 50
"""what is compiled or cached in these does not count"""
_SPAN = 0.01
"""m, of the motion it is played with"""


@dataclass(frozen=True)
class ControllerTime:
    """s of a tick in the 99th percentile of a round, the least of all rounds: what a host takes
    from one round it does not take from each."""

    seconds: float
    period: float
    limit: float
    """share of the period"""

    @property
    def share(self) -> float:
        return self.seconds / self.period

    @property
    def ok(self) -> bool:
        return self.share <= self.limit


def controller_time(
    config: Config, name: str, clock: Callable[[], int] | None = None
) -> ControllerTime:
    """Measure `stiffness`, `wrench`, `tensions` and `applied` together by the wall ``clock`` (ns),
    so that waiting counts as well as computing. Raises `ControllerError`."""
    now = clock or Stopwatch(running=True).wall_ns
    probe = Probe(name, config.robot, config.control)
    probe.begin()
    taken = np.empty((ROUNDS, TICKS))
    for tick in range(-WARM_TICKS, taken.size):
        offset = _SPAN * np.sin(0.01 * tick + np.arange(3.0))
        motion = probe.displaced(offset, offset)
        begun = now()
        probe.tick(motion)
        if tick >= 0:
            taken.flat[tick] = now() - begun
    seconds = 1e-9 * float(np.percentile(taken, 99, axis=1).min())
    return ControllerTime(seconds, config.control.rates.period, config.realtime.controller_share)
