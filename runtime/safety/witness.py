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
        length = (1.0 - share) * self._lengths[newer] + share * self._lengths[older]
        tension = (1.0 - share) * self._tensions[newer] + share * self._tensions[older]
        self._seen.evaluate(position, quaternion)
        gap = length - self._seen.lengths
        if not (np.isfinite(gap).all() and np.isfinite(tension).all()):
            return
        self._compare(gap, tension > self._taut, length * tension / self._stiffness)

    def _compare(self, gap: Array, taut: NDArray[np.bool_], stretch: Array) -> None:
        """``gap`` (n,) m: length less distance; ``stretch`` (n,) m of it is elongation."""
        count = len(self._gaps)
        slot, before = self._poses % count, (self._poses - 1) % count
        if self._poses:
            self._gaps += self._moved(gap - self._last)
        full = self._poses >= count
        then, stretched = self._gaps[slot].copy(), self._stretches[slot].copy()
        self._last[:] = gap
        known = self._poses > 0
        self._gaps[slot] = np.where(taut, gap, self._gaps[before]) if known else gap
        self._stretches[slot] = np.where(taut, stretch, self._stretches[before] if known else 0.0)
        self._poses += 1
        if full:
            self._judge(gap - then, taut, np.abs(stretch - stretched))

    def _judge(self, change: Array, taut: NDArray[np.bool_], stretch: Array) -> None:
        settings = self._settings
        off = np.abs(change) * ((taut | (change < 0.0)) & ~self._excluded)
        cable = int(off.argmax())
        second = float(np.sort(off)[-2])
        limit = settings.witness + settings.witness_share * stretch[cable]
        told = int((taut & ~self._excluded).sum()) + int(not taut[cable]) >= _FEWEST
        wrong = told and off[cable] > max(limit, settings.prominence * second)
        same = wrong and cable == self._named
        self._times = self._times + 1 if same else int(wrong)
        self._named = cable if wrong else -1

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
