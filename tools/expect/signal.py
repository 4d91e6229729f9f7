"""A signal of a log, or a part of it, and what it has to have done."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from difflib import get_close_matches
from operator import methodcaller
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonus.runtime.states import State
from tonus.tools.errors import ToolError
from tonus.tools.expect.failure import ExpectationError

__tracebackhide__ = methodcaller("errisinstance", ExpectationError)
"""For pytest, as in `tonus.tools.expect.run`."""
Floats = NDArray[np.float64]
Fail = Callable[[str, float | None], ExpectationError]
"""Makes the error for a figure and its time in s."""


class NoElementError(ToolError, IndexError):
    """An element that a signal does not have; ends a loop over its elements, too."""


@dataclass(frozen=True)
class Signal:
    """``values`` (n,) or (n, k) at ``times`` (n,), s since the log's first message.

    A question about a part in which the run has no sample raises `ExpectationError`: nothing is
    shown by what was never there.
    """

    name: str
    unit: str
    times: Floats
    values: Floats
    states: NDArray[np.uint8]
    """(n,) state of the machine at each time"""
    fail: Fail
    part: str = ""
    """which part of the run this is, in words"""

    def during(self, *states: State | str) -> Signal:
        """The samples in these states, by name or as `State`. Raises `ToolError` for a name that
        is no state."""
        wanted = [_state(each) for each in states]
        names = " or ".join(each.name for each in wanted)
        return self._chosen(np.isin(self.states, wanted), f"in {names}")

    def between(self, start: float, end: float) -> Signal:
        """The samples with start <= time < end, s since the log's first message."""
        chosen = (self.times >= start) & (self.times < end)
        return self._chosen(chosen, f"from {start:g} s to {end:g} s")

    def norm(self) -> Signal:
        """Euclidean length of each sample (n, k) as a signal (n,): the speed of a velocity."""
        if self.values.ndim == 1:
            return replace(self, name=f"|{self.name}|", values=np.abs(self.values))
        return replace(self, name=f"|{self.name}|", values=np.linalg.norm(self.values, axis=1))

    def __getitem__(self, index: int) -> Signal:
        """One element of each sample (n, k): one cable, one axis. Raises `NoElementError`."""
        if self.values.ndim == 1:
            raise NoElementError(f"{self.name} is a scalar; leave the index out")
        width = self.values.shape[1]
        if not -width <= index < width:
            remedy = f"choose one from 0 to {width - 1}"
            raise NoElementError(f"{self.name} has no element {index}; {remedy}")
        return replace(self, name=f"{self.name}[{index}]", values=self.values[:, index])

    def stays(self, low: float, high: float) -> None:
        """Every sample lies in [low, high]; what is not a number does not. Raises `ToolError` for
        bounds between which nothing lies."""
        if not low <= high:
            raise ToolError(
                f"{self.name} stays({low:g}, {high:g}): low <= high must hold; swap them"
            )
        self._there()
        wrong = np.asarray(~((self.values >= low) & (self.values <= high)))
        if not wrong.any():
            return
        first, worst = self._first(wrong), self._worst(wrong, low, high)
        text = f"{self._figure(first)}, which is not in [{low:g}, {high:g}]"
        if worst != first:
            text += f"; farthest {replace(self, part='')._figure(worst)}"
        raise self.fail(f"{text}; {self._share(wrong)}", float(self.times[first[0]]))

    def settles(self, value: ArrayLike, *, band: float, within: float) -> float:
        """s from the first sample until every later one is within ``band`` of ``value`` (a number,
        or one for each element), which has to be at most ``within``."""
        self._there()
        apart = np.asarray(np.abs(self.values - np.asarray(value, dtype=np.float64)))
        wrong = np.asarray(~(apart <= band))
        rows = _rows(wrong)
        start = float(self.times[0])
        if not rows.any():
            return 0.0
        last = len(rows) - 1 - int(rows[::-1].argmax())
        shown = np.array2string(np.asarray(value), precision=4)
        if last == len(rows) - 1:
            text = f"{self._figure((last, *self._first(wrong[last])))}, the end of this part"
            text += f": it does not settle to {shown} +- {band:g}"
            raise self.fail(text, float(self.times[last]))
        took = float(self.times[last + 1]) - start
        if took > within:
            text = (
                f"{self._titled} settles to {shown} +- {band:g} {self.unit} in {took:.3f} s, "
                f"and not within {within:g} s"
            )
            raise self.fail(text, float(self.times[last + 1]))
        return took

    def rms(self, *, about: ArrayLike = 0.0, at_most: float | None = None) -> float:
        """Root mean square of the samples' distance from ``about``; of a vector its Euclidean
        length. It has to be ``at_most`` that, where given."""
        self._there()
        if not isinstance(at_most, int | float | None):
            raise ToolError(f"{self.name} rms: at_most: {at_most!r} is no number; give one")
        apart = self.values - np.asarray(about, dtype=np.float64)
        squares = apart**2 if apart.ndim == 1 else (apart**2).sum(axis=1)
        found = float(np.sqrt(squares.mean()))
        if at_most is not None and not found <= at_most:
            worst = int(np.where(np.isfinite(squares), squares, np.inf).argmax())
            text = f"{self._titled} has an RMS of {found:.4g} {self.unit}, more than {at_most:g}"
            time = float(self.times[worst])
            raise self.fail(f"{text}; largest at {time:.3f} s", time)
        return found

    @property
    def _titled(self) -> str:
        return f"{self.name} {self.part}".rstrip()

    def _chosen(self, chosen: NDArray[np.bool_], part: str) -> Signal:
        found = replace(
            self,
            times=self.times[chosen],
            values=self.values[chosen],
            states=self.states[chosen],
            part=f"{self.part} {part}".lstrip(),
        )
        found._there()
        return found

    def _there(self) -> None:
        if not len(self.times):
            raise self.fail(f"{self._titled}: the run has no sample there", None)

    def _first(self, wrong: NDArray[np.bool_]) -> tuple[int, ...]:
        return tuple(int(each) for each in np.argwhere(wrong)[0])

    def _worst(self, wrong: NDArray[np.bool_], low: float, high: float) -> tuple[int, ...]:
        excess = np.maximum(low - self.values, self.values - high)
        excess = np.where(np.isnan(excess), np.inf, excess)
        at = np.unravel_index(np.where(wrong, excess, -np.inf).argmax(), wrong.shape)
        return tuple(int(each) for each in at)

    def _figure(self, at: tuple[int, ...]) -> str:
        element = f"[{at[1]}]" if len(at) > 1 else ""
        value, time = float(self.values[at]), float(self.times[at[0]])
        titled = f"{self.name}{element} {self.part}".rstrip()
        return f"{titled} is {value:.6g} {self.unit}".rstrip() + f" at {time:.3f} s"

    def _share(self, wrong: NDArray[np.bool_]) -> str:
        rows = _rows(wrong)
        return f"{int(rows.sum())} of {len(rows)} samples"


def _rows(wrong: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(n,) whether any element of a sample is."""
    return wrong if wrong.ndim == 1 else np.asarray(wrong.any(axis=1))


def _state(name: Any) -> State:
    if isinstance(name, State):
        return name
    try:
        return State[name]
    except KeyError:
        known = [each.name for each in State]
        close = get_close_matches(str(name), known, 1)
        remedy = f"did you mean {close[0]}?" if close else f"choose one of {', '.join(known)}"
        raise ToolError(f"there is no state {name!r}; {remedy}") from None
