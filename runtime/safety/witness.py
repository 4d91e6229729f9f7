"""Whether each drum has the cable that the tracker sees: a length that is wrong, by another witness
than the estimate.

Eight lengths of a body with six degrees of freedom contradict each other in two directions only, in
which the cables of one half of the robot look alike: an error that comes slowly moves the estimate
and names no cable. The tracker's pose gives every distance by itself. What a length differs by from
its distance is calibration, which changes slowly, and slack; what it has changed by since a while
ago is an error of the drum, its encoder, its cable or its cell.

- A slack cable is longer than its distance, never shorter: it counts only as too short, and is
  compared with what it was when it last pulled.
- The elongation is known to a share of itself.
- A tracker that is moved changes all distances at once, as a translation does; so much is taken
  out, and nobody is named for it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.robot import Robot
from tonus.config.schema.safety import Isolation as Settings
from tonus.config.schema.tracker import Tracker
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.control.kinematics import Kinematics

Array = NDArray[np.float64]
_SAMPLES = 3
"""in a row that have to agree"""
_FEWEST = 5
"""lengths that are compared, the wrong one among them"""
_UNEXPLAINED = 0.25
"""share of a common step that a translation of the tracker may leave"""
_SURELY = 0.999
"""share of a limit below which a few bits do not matter"""


@njit(cache=True)
def _measure(
    lengths: Array,
    tensions: Array,
    newer: int,
    older: int,
    share: float,
    distance: Array,
    axial_stiffness: Array,
    pulling: float,
    gap: Array,
    stretch: Array,
    taut: NDArray[np.bool_],
) -> bool:
    """Of the instant a ``share`` of the way from row ``newer`` to row ``older``: what each length
    exceeds its ``distance`` by, its elongation (m), and whether its cable is ``pulling`` (N).
    Whether all are numbers."""
    finite = True
    for i in range(gap.shape[0]):
        length = (1.0 - share) * lengths[newer, i] + share * lengths[older, i]
        tension = (1.0 - share) * tensions[newer, i] + share * tensions[older, i]
        gap[i] = length - distance[i]
        stretch[i] = length * tension / axial_stiffness[i]
        taut[i] = tension > pulling
        finite = finite and math.isfinite(gap[i]) and math.isfinite(tension)
    return finite


@njit(cache=True)
def _is_small(matrix: Array, step: Array, limit: float) -> bool:
    """Whether the translation that explains a ``step`` (n,) of the lengths best is below a
    ``limit`` (m), by Cramer's rule: a few bits less certain than what solves it, and without what
    that costs. ``matrix`` (6, n): structure matrix."""
    xx = xy = xz = yy = yz = zz = x = y = z = 0.0
    for i in range(step.shape[0]):
        a, b, c = matrix[0, i], matrix[1, i], matrix[2, i]
        xx, xy, xz = xx + a * a, xy + a * b, xz + a * c
        yy, yz, zz = yy + b * b, yz + b * c, zz + c * c
        x, y, z = x + a * step[i], y + b * step[i], z + c * step[i]
    first, second, third = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    size = xx * first + xy * second + xz * third
    along = first * x + second * y + third * z
    across = second * x + (xx * zz - xz * xz) * y + (xy * xz - xx * yz) * z
    upward = third * x + (xy * xz - xx * yz) * y + (xx * yy - xy * xy) * z
    return math.sqrt(along * along + across * across + upward * upward) < limit * size


@njit(cache=True)
def _keep(
    gap: Array,
    taut: NDArray[np.bool_],
    stretch: Array,
    slot: int,
    before: int,
    known: bool,
    gaps: Array,
    stretches: Array,
    change: Array,
    stretched: Array,
) -> None:
    """Put a pose into row ``slot``, of a slack cable what row ``before`` has, if that is ``known``;
    what gap and elongation have changed by since that row's last pose."""
    for i in range(gap.shape[0]):
        change[i] = gap[i] - gaps[slot, i]
        stretched[i] = abs(stretch[i] - stretches[slot, i])
        gaps[slot, i] = gaps[before, i] if known and not taut[i] else gap[i]
        if taut[i]:
            stretches[slot, i] = stretch[i]
        else:
            stretches[slot, i] = stretches[before, i] if known else 0.0


# Compiled with the file: the first to ask it is a pose far into a run.
@njit(
    "int64(float64[::1], boolean[::1], boolean[::1], float64[::1], float64, float64, float64)",
    cache=True,
)
def _contradicting(
    change: Array,
    taut: NDArray[np.bool_],
    excluded: NDArray[np.bool_],
    stretch: Array,
    witness: float,
    witness_share: float,
    prominence: float,
) -> int:
    """The cable whose ``change`` is beyond its limit and stands out, or -1."""
    off = np.abs(change) * (~excluded & (taut | (change < 0.0)))
    cable, ordered = int(off.argmax()), np.sort(off)
    compared = np.count_nonzero(taut & ~excluded) + (not taut[cable])
    limit = witness + witness_share * stretch[cable]
    if compared >= _FEWEST and ordered[-1] > max(limit, prominence * ordered[-2]):
        return cable
    return -1


class Witness:
    """The tracker's poses held against the drums' lengths; `misread` is the cable they name."""

    def __init__(
        self, robot: Robot, settings: Settings, tracker: Tracker, taut: float, period: float
    ) -> None:
        """``taut``: N above which a cable pulls."""
        self._settings, self._taut, self._period = settings, taut, period
        self._stiffness = robot.axial_stiffness
        self._seen = Kinematics(robot.geometry)
        cables = robot.cables
        ticks = math.ceil(tracker.maximum_age_ms * 1e-3 / period) + 2
        self._lengths, self._tensions = np.zeros((ticks, cables)), np.zeros((ticks, cables))
        samples = max(_SAMPLES, math.ceil(settings.witness_s * tracker.rate_hz))
        self._gaps, self._stretches = np.zeros((samples, cables)), np.zeros((samples, cables))
        self._last = np.zeros(cables)
        self._excluded = np.zeros(cables, dtype=bool)
        self._ticks = self._poses = 0
        self._named, self._times = -1, 0
        """by the last pose, -1 for nobody; by how many in a row"""

    def reset(self) -> None:
        """A new reference: what was known of the lengths is void."""
        self._ticks = self._poses = self._times = 0

    @property
    def misread(self) -> int:
        """The cable whose length is wrong, or -1."""
        return self._named if self._times >= _SAMPLES else -1

    def step(
        self, image: ProcessImage, lengths: Array, tension: Array, excluded: NDArray[np.bool_]
    ) -> None:
        """From cable lengths (n,) m, elongation included, and tensions (n,) N of this tick, and the
        tracker's pose, where one came; a cable that is ``excluded`` (n,) has its name."""
        self._excluded = excluded
        slot = self._ticks % len(self._lengths)
        self._lengths[slot], self._tensions[slot] = lengths, tension
        self._ticks += 1
        tracker = image.tracker
        if tracker["fresh"]:
            self._see(tracker["position"], tracker["quaternion"], float(tracker["delay"]))

    def _see(self, position: Array, quaternion: Array, delay: float) -> None:
        depth = len(self._lengths)
        back = delay / self._period - 1.0
        if not 0.0 <= back <= min(self._ticks, depth) - 2:
            return
        whole = int(back)
        share, newer = back - whole, (self._ticks - 1 - whole) % depth
        older = (newer - 1) % depth
        self._seen.evaluate(position, quaternion)
        cables = len(self._last)
        gap, stretch, taut = np.empty(cables), np.empty(cables), np.empty(cables, dtype=bool)
        if _measure(
            self._lengths,
            self._tensions,
            newer,
            older,
            share,
            self._seen.lengths,
            self._stiffness,
            self._taut,
            gap,
            stretch,
            taut,
        ):
            self._compare(gap, taut, stretch)

    def _compare(self, gap: Array, taut: NDArray[np.bool_], stretch: Array) -> None:
        """``gap`` (n,) m: length less distance; ``stretch`` (n,) m of it is elongation."""
        count = len(self._gaps)
        known, full = self._poses > 0, self._poses >= count
        if known:
            step = gap - self._last
            if not _is_small(self._seen.matrix, step, _SURELY * self._settings.witness):
                self._gaps += self._moved(step)
        slot, before = self._poses % count, (self._poses - 1) % count
        change, stretched = np.empty(len(gap)), np.empty(len(gap))
        self._last[:] = gap
        _keep(
            gap, taut, stretch, slot, before, known, self._gaps, self._stretches, change, stretched
        )
        self._poses += 1
        if full:
            self._judge(change, taut, stretched)

    def _judge(self, change: Array, taut: NDArray[np.bool_], stretch: Array) -> None:
        s = self._settings
        cable = _contradicting(
            change, taut, self._excluded, stretch, s.witness, s.witness_share, s.prominence
        )
        self._times = self._times + 1 if cable == self._named else 1
        self._named = cable

    def _moved(self, step: Array) -> Array:
        """(n,) m of a pose's ``step`` (n,) m of all lengths that is a translation of the tracker,
        nothing if that explains it badly or is small."""
        directions = self._seen.matrix[:3]
        shift = np.linalg.solve(directions @ directions.T, directions @ step)
        if float(np.linalg.norm(shift)) < self._settings.witness:
            return np.zeros(len(step))
        common = shift @ directions
        left = float(np.sum((step - common) ** 2))
        explained = left < _UNEXPLAINED * float(np.sum(step**2))
        return np.asarray(common if explained else np.zeros(len(step)))
