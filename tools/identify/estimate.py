"""A value with its interval, and where intervals come from."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from tonus.config.schema.robot import Robot

Array = NDArray[np.float64]
_CONFIDENCE = 0.95
NORMAL = 1.96
"""from a known standard error to the half width of that confidence"""
_NEGLIGIBLE = 0.02
"""a difference of this share is no reason to change a configuration"""
_VAGUE = 0.5
"""an interval wider than this share of the value says that it was not excited"""
_FAR = 1_000_000
_FEWEST_BLOCKS = 3
_SINGULAR = 1e12
"""condition number of the normal equations beyond which parameters cannot be told apart"""


@dataclass(frozen=True)
class Estimate:
    """One identified value. ``half_width`` is of its 95 % interval."""

    name: str
    text: str
    unit: str
    value: float
    half_width: float
    configured: float | None = None
    each: tuple[float, ...] = ()
    """of the single cables or drums, NaN where one could not be identified"""
    truth: float | None = None
    key: str = ""
    """of the configuration: ``{}`` in it stands for each of `axes`; empty: none holds this value"""
    axes: tuple[int, ...] = ()
    """whose value it is; empty: of all, or of none"""

    @property
    def keys(self) -> tuple[str, ...]:
        """Every key of the configuration that holds this value."""
        if not self.key:
            return ()
        if "{}" not in self.key:
            return (self.key,)
        return tuple(self.key.format(axis) for axis in self.axes)

    @property
    def verdict(self) -> str:
        """In the light of the configured value, or of none."""
        known = self.configured
        if known is None:
            return "none found" if self.half_width >= abs(self.value) else ""
        off = self.value - known
        if abs(off) > max(self.half_width, _NEGLIGIBLE * abs(known)):
            return f"differs {100.0 * off / known:+.1f} %" if known else "differs"
        vague = self.half_width > _VAGUE * max(abs(self.value), abs(known))
        return "uncertain" if vague else "as configured"


@dataclass(frozen=True)
class Fit:
    """A least-squares solution."""

    value: Array
    """(p,)"""
    half_width: Array
    """(p,), of the 95 % intervals"""
    residual: Array
    """(n,)"""
    blocks: NDArray[np.int64]
    """(b,) numbers of the blocks"""
    influence: Array
    """(b, p): how far each block shifts the values"""
    quantile: float
    """Student's, for as many blocks"""


def fit(
    residuals: Callable[[Array], Array],
    start: Array,
    blocks: NDArray[np.int64],
    *,
    scale: Array | None = None,
) -> Fit | None:
    """Least squares whose intervals hold although neighbouring residuals (n,) are alike.

    ``blocks`` (n,) numbers stretches that may be taken as independent. The covariance is the
    jackknife over them: each is left out once, to first order, so that a residual that lasts, from
    a model that is not quite right too, counts once a block and not once a sample (CR3 of Bell and
    McCaffrey 2002). Student's t has a degree of freedom for each block but one. None when the data
    without any one block do not determine the parameters.
    """
    names, numbers = np.unique(blocks, return_inverse=True)
    count, size = len(names), len(start)
    if count < _FEWEST_BLOCKS:
        return None
    found = least_squares(residuals, start, x_scale=1.0 if scale is None else scale)
    jacobian, rest = np.asarray(found.jac), np.asarray(found.fun)
    norms = np.linalg.norm(jacobian, axis=0)
    if not norms.all():
        return None
    jacobian = jacobian / norms
    whole = jacobian.T @ jacobian
    scores, without = np.empty((count, size)), np.empty((count, size, size))
    ends = np.cumsum(np.bincount(numbers))[:-1]
    for block, chosen in enumerate(np.split(np.argsort(numbers, kind="stable"), ends)):
        part = jacobian[chosen]
        scores[block] = rest[chosen] @ part
        without[block] = whole - part.T @ part
    if np.linalg.cond(without).max() > _SINGULAR:
        return None
    influence = np.linalg.solve(without, scores[:, :, None])[:, :, 0] / norms
    influence *= np.sqrt((count - 1) / count)
    quantile = float(student.ppf(0.5 + 0.5 * _CONFIDENCE, count - 1))
    half_width = quantile * np.linalg.norm(influence, axis=0)
    return Fit(np.asarray(found.x), half_width, rest, names, influence, quantile)


def numbered(parts: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """The block numbers of several records in one row, none of them alike."""
    return np.concatenate([number * _FAR + part for number, part in enumerate(parts)])


def per_kind(
    robot: Robot, section: str, field: str, fits: Sequence[Fit | None]
) -> Iterator[tuple[tuple[int, ...], str, float]]:
    """Of every group of axes that share a configured value and have a fit: the axes, the key of the
    configuration, and the value."""
    for axes, own in robot.groups_of_axes(section, field):
        if any(fits[axis] is not None for axis in axes):
            value = float(getattr(getattr(robot.drive_trains[axes[0]], section), field))
            place = "robot.axes.{}" if own else "robot"
            yield axes, f"{place}.{section}.{field}", value


def mean_of(fits: Sequence[Fit | None], index: int) -> tuple[float, float]:
    """Mean of one parameter over several fits, and half the width of its interval. What the fits
    have in common, as one tracker's noise, shifts them together and is counted so."""
    known = [found for found in fits if found is not None]
    names = np.unique(np.concatenate([found.blocks for found in known]))
    together = np.zeros(len(names))
    for found in known:
        together[np.searchsorted(names, found.blocks)] += found.influence[:, index] / len(known)
    value = float(np.mean([found.value[index] for found in known]))
    return value, max(found.quantile for found in known) * float(np.linalg.norm(together))


def each_of(fits: Sequence[Fit | None], index: int) -> tuple[float, ...]:
    """One parameter of every fit, NaN where there is none."""
    return tuple(float(found.value[index]) if found else float("nan") for found in fits)
