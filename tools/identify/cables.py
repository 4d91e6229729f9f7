"""EA of every cable: how much longer than it was wound a cable is at its tension."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tonus.runtime.states import State
from tonus.tools.identify.estimate import (
    NORMAL,
    Estimate,
    Fit,
    each_of,
    fit,
    mean_of,
    numbered,
    per_kind,
)
from tonus.tools.identify.record import BLOCK_S, Record, ways

Array = NDArray[np.float64]
_STATES = (State.REFERENCING, State.PRETENSION, State.HOLD, State.ACTIVE)
_FIRST_GUESS_N = 1e4
_NARROWEST_N = 5.0
"""range of tension, below which its stretch is lost in the tracker's noise"""


def identify_cables(records: Sequence[Record], anchor_sigma: float) -> list[Estimate]:
    """EA, from l = (L0 − r θ)(1 + T/EA) at the tracker's poses: bring-up, from straight to
    pretension, says most. Empty when no cable's tension changed enough. Each coordinate of an
    anchor may be wrong by ``anchor_sigma`` (m), standard error."""
    robot = records[0].config.robot
    stretches = [[_stretch(record, cable) for record in records] for cable in range(robot.cables)]
    fits = [_fit(parts) for parts in stretches]
    if not any(fits):
        return []
    estimates = []
    for axes, key, configured in per_kind(robot, "cable", "axial_stiffness", fits):
        some = [fits[cable] for cable in axes]
        value, half_width = mean_of(some, 0)
        askew = sum(
            _change(found, stretches[cable], axis, anchor_sigma) ** 2
            for found, cable in zip(some, axes, strict=True)
            for axis in range(3)
            if found is not None
        )
        count = sum(found is not None for found in some)
        half_width = math.hypot(half_width, NORMAL * math.sqrt(askew) / count)
        estimates.append(
            Estimate(
                "axial_stiffness",
                f"cable stiffness EA{robot.whose(axes)}",
                "N",
                value,
                half_width,
                configured,
                each_of(some, 0),
                key=key,
                axes=axes,
            )
        )
    return estimates


def _change(found: Fit, parts: list[_Stretch], axis: int, anchor_sigma: float) -> float:
    """What an anchor that is off along an axis does to EA (N)."""
    if anchor_sigma == 0.0:
        return 0.0
    moved = _fit([part.with_anchor(axis, anchor_sigma) for part in parts])
    return 0.0 if moved is None else float(moved.value[0] - found.value[0])


@dataclass(frozen=True)
class _Stretch:
    """One cable of one record at the tracker's exposures: arrays (m, ...)."""

    block: NDArray[np.int64]
    way: Array
    """m (m, 3), from platform to frame anchor"""
    wound: Array
    """m of cable, r θ"""
    rate: Array
    """m/s, its derivative"""
    tension: Array

    @property
    def length(self) -> Array:
        """m, anchor to anchor"""
        return np.asarray(np.linalg.norm(self.way, axis=1))

    def with_anchor(self, axis: int, offset: float) -> _Stretch:
        """The same had the frame's anchor been elsewhere."""
        return replace(self, way=self.way + offset * np.eye(3)[axis])


def _stretch(record: Record, cable: int) -> _Stretch:
    taut = np.interp(record.exposure, record.time, record.inner(record.during(*_STATES))) == 1.0
    at = record.exposure[taut]
    way = ways(record.config, record.seen_position[taut], record.seen_rotation[taut])[:, cable]
    wound = float(record.config.robot.drum_radius[cable]) * record.smooth(record.angle[:, cable])
    columns = (
        wound,
        np.gradient(wound, record.period),
        record.smooth(record.tension[:, cable]),
    )
    seen = (np.interp(at, record.time, column) for column in columns)
    return _Stretch((at / BLOCK_S).astype(np.int64), way, *seen)


def _fit(parts: list[_Stretch]) -> Fit | None:
    """EA, then how late the encoder is against the tracker (s), then L0 in each record."""
    parts = [part for part in parts if len(part.way)]
    if not parts or max(float(np.ptp(part.tension)) for part in parts) < _NARROWEST_N:
        return None
    lengths = [part.length for part in parts]

    def residuals(p: Array) -> Array:
        return np.concatenate(
            [
                (unstretched - part.wound - p[1] * part.rate) * (1.0 + part.tension / p[0]) - length
                for part, length, unstretched in zip(parts, lengths, p[2:], strict=True)
            ]
        )

    longest = [float(np.mean(length + p.wound)) for p, length in zip(parts, lengths, strict=True)]
    start = np.array([_FIRST_GUESS_N, 0.0, *longest])
    scale = np.array([_FIRST_GUESS_N, 1e-3, *(1e-2 for _ in parts)])
    return fit(residuals, start, numbered([part.block for part in parts]), scale=scale)
