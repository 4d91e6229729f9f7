"""A stop under a load: the least that physics allows, beside what a run reached."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import nan

from tests.bench.least_stop.grid import LOADED
from tests.bench.least_stop.model import Model
from tests.bench.least_stop.problem import Case, Solution
from tests.bench.least_stop.solve import SLOWER, Solver

ITERATIONS = 300


@dataclass(frozen=True)
class Reached:
    """What a run did from the break on."""

    speed: float
    """m/s, largest of the platform's origin"""
    after: float
    """s after the break, where it was reached"""
    tension: float
    """N, largest of any cable"""


@dataclass(frozen=True)
class Least:
    """The optimum from one start."""

    start: str
    fast: Solution
    gentle: Solution

    @property
    def tension(self) -> float:
        """N; not a number where the second stage did not converge."""
        return self.gentle.peak_tension if self.gentle.converged else nan

    def __str__(self) -> str:
        speed = f"{self.fast.peak_speed:.4f} m/s" if self.fast.converged else "not converged"
        return (
            f"  from {self.start:8s} {speed}, {self.tension:.1f} N, "
            f"{self.fast.iterations}+{self.gentle.iterations} iterations"
        )


def optima(model: Model, case: Case, tension: float, starts: Iterable[str]) -> Iterator[Least]:
    """From each start, with tensions up to ``tension`` N."""
    solver = Solver(model, tension, LOADED, iterations=ITERATIONS)
    for start in starts:
        yield Least(start, *solver.solve(case, start))


def compared(found: Iterable[Least], reached: Reached) -> str:
    """The lowest of those that converged, what was reached, and the ratios."""
    good = [least for least in found if least.fast.converged]
    did = f"reached {reached.speed:.3f} m/s {1e3 * reached.after:.0f} ms after the break, "
    did += f"{reached.tension:.1f} N"
    if not good:
        return f"  none converges; {did}"
    speed = min(least.fast.peak_speed for least in good)
    about = [each.tension for each in good if each.fast.peak_speed <= SLOWER * speed]
    tension = min((newtons for newtons in about if newtons == newtons), default=nan)
    ratios = f"{reached.speed / speed:.2f} and {reached.tension / tension:.2f} times"
    return f"  least {speed:.3f} m/s, {tension:.1f} N; {did}: {ratios}"
