"""The samples that the plots show."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from tonus.tools.view.moment import Array, Samples, joined
from tonus.tools.view.settings import settings
from tonus.tools.view.signals import Plot, Series


class Window:
    """The last seconds of one run."""

    def __init__(self) -> None:
        self._parts: deque[Samples] = deque()

    @property
    def newest_s(self) -> float:
        """Time of the newest sample; minus infinity without one."""
        return float(self._parts[-1].times[-1]) if self._parts else -np.inf

    def add(self, samples: Samples, *, jumped: bool) -> None:
        """What came; what has left the window goes."""
        if jumped:
            self._parts.clear()
        if not len(samples):
            return
        self._parts.append(samples)
        oldest = self.newest_s - settings().window_s
        while self._parts[0].times[-1] < oldest:
            self._parts.popleft()

    def after(self, time_s: float) -> Samples | None:
        """What came after a time; None for nothing."""
        parts = [part for part in self._parts if part.times[-1] > time_s]
        return joined(parts).between(time_s, np.inf) if parts else None


def points(
    samples: Samples | None, plots: Sequence[Plot], chosen: Sequence[Series]
) -> dict[str, Any]:
    """For the page: the times, each plot's lines, and those of the chosen signals."""
    if samples is None:
        return {"t": [], "plots": [], "chosen": []}
    return {
        "t": _numbers(samples.times),
        "plots": [[_numbers(each.take(samples)) for each in plot.series] for plot in plots],
        "chosen": [_numbers(each.take(samples)) for each in chosen],
    }


def _numbers(values: Array) -> list[float | None]:
    """JSON has no number for what is none."""
    return [round(value, 6) if np.isfinite(value) else None for value in values.tolist()]
