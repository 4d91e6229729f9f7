"""How many frames in a row may be lost, and how late one may be, before anything acts on it."""

from __future__ import annotations

import math

from tonus.config.schema.base import Count, Section


class LostFrames(Section):
    """Frames in a row that stop nothing, by kind."""

    heartbeat: Count = 1
    """of the daemon to a drive, or of a node to the daemon"""
    sync: Count = 1
    pdo: Count = 1
    """either way"""
    ethercat: Count = 1
    """process data frames of a segment"""
    tracker: Count = 1
    """poses"""


class Tolerance(Section):
    """Every timeout follows from it, or is checked against it by `tonus check`."""

    lost: LostFrames = LostFrames()
    jitter_ms: Count
    """how much later than its period a heartbeat, an output or a pose may be: the host's stalls,
    the grid of the ticks, arbitration. Without it the value of `tonus.config.schema.place`"""
    late_ticks: Count = 1
    """ticks by which a measurement may be late beside the lost ones"""

    def timeout_ms(self, period_ms: float, lost: int) -> int:
        """The shortest wait for a frame that comes each ``period_ms``: the tolerated losses, the
        frame behind them, and the jitter."""
        return math.ceil((lost + 1) * period_ms + self.jitter_ms)

    def fresh_ticks(self, lost: int) -> int:
        """The least age in ticks up to which a measurement must be usable."""
        return lost + self.late_ticks
