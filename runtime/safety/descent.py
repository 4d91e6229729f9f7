"""The descent: a stop with the remaining cables, their tension references and their bounds.

The wrench is the weight and a damper of every motion; forces have priority over moments, because a
platform that may turn stays slower (docs/stop.md). Most of a load from outside is balanced, but not
what a given-up cable without a cell may pull: the estimate sees that pull as a load, and late, so
that the drums would swing against it. A slack cable cannot pull: its drum follows the
platform and slowly removes the slack. The tension of an excluded cable counts as a load.

At first after the loss of a torn cable the drum of one that pulls more than it is asked for pays
out what the platform takes: damping its own rate it would pull on.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.control import Control
from tonus.config.schema.robot import Robot
from tonus.runtime.control.controllers.base import norm
from tonus.runtime.control.distribution import TensionDistribution
from tonus.runtime.control.tension import TensionLoop
from tonus.runtime.safety.faults import Faults
from tonus.runtime.safety.guard import Guard

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_SWEEPS = 20
"""Two cables 30 degrees apart leave less than a hundredth after so many."""


@njit(cache=True)
def _unexplained(matrix: Array, pulling: Mask, force: Array) -> None:
    """Take out of a ``force`` (3,) N, in place, the most that the cables ``pulling`` (n,) can make
    up of it, none of which pushes: non-negative least squares, by coordinates. ``matrix`` (6, n):
    structure matrix, whose columns begin with unit vectors."""
    pulls = np.zeros(pulling.shape[0])
    for _ in range(_SWEEPS):
        for i in range(pulling.shape[0]):
            if not pulling[i]:
                continue
            along = 0.0
            for k in range(3):
                along += matrix[k, i] * force[k]
            more = max(along, -pulls[i])
            pulls[i] += more
            for k in range(3):
                force[k] -= more * matrix[k, i]


@njit(cache=True)
def _paid_out(
    following: Array, desired: Array, paying: Mask, damping: Array, torque: Array
) -> None:
    """Damp the rates of the drums ``paying`` out (n,) against those ``following`` the platform (n,)
    rad/s where these pay out faster than the ``desired`` (n,), which the ``damping`` (n,) N m s/rad
    that is in ``torque`` (n,) N m already is against."""
    for i in range(torque.shape[0]):
        ahead = following[i] - desired[i]
        if paying[i] and math.isfinite(ahead):
            torque[i] += damping[i] * min(ahead, 0.0)


def _share(part: float, whole: float) -> float:
    return part / whole if part < whole else 1.0


class Descent:
    """Tension references and torques of a descent, and the guard that bounds them."""

    def __init__(self, robot: Robot, control: Control, period: float) -> None:
        self._stop, self._period = control.stop, period
        self.distribution = TensionDistribution(
            control.distribution, control.stop.moment_length, robot.cables
        )
        stiff = {"proportional": control.stop.proportional, "integral": 0.0}
        self.loop = TensionLoop(robot, control.tension_loop.model_copy(update=stiff), period)
        self.guard = Guard(robot, control.stop, period)
        self.taut = np.ones(robot.cables, dtype=bool)
        """(n,) cables that pull; a slack one has to come back above `taut_tension`"""
        self.centre = np.zeros(robot.cables)
        """N (n,), what tensions are drawn towards: from what they were to the passive tension"""
        self.planned = np.zeros(robot.cables)
        """N (n,), the last tension references"""
        self._most = np.zeros(robot.cables)
        self._calm = _share(control.stop.calm, control.stop.proportional)
        self._eager, self._thrown = 1.0, 0.0
        self._calming = math.exp(-period / control.stop.ease_s)
        self._gone = np.zeros(robot.cables, dtype=bool)
        self._felt = np.zeros(robot.cables)
        self._paying = np.zeros(robot.cables, dtype=bool)
        """(n,) cables that pull more than they are asked for, after one was torn"""
        self._pushing = np.zeros(robot.cables, dtype=bool)
        """(n,) cables that push by their cells, which no cable can: they may well be taut"""
        self.taking_up = np.zeros(robot.cables, dtype=bool)
        """(n,) given-up cables whose slack was taken up in this tick, by their cells and drums"""
        self._release = math.exp(-period / control.stop.release_s)
        self._low, self._high = np.zeros(robot.cables), np.zeros(robot.cables)
        self._load = np.zeros(3)

    def begin(self, tension: Array) -> None:
        """From tensions (n,) of this tick."""
        self.guard.reset()
        self._eager, self._thrown = 1.0, 0.0
        self.centre[:] = tension
        self.taut[:] = True

    def balanced(self, matrix: Array, external: Array, faults: Faults, height: float) -> Array:
        """The part (3,) N of the estimated ``external`` force that the descent balances: what no
        given-up cable without a usable cell can pull, beyond what errors of the estimate make up.
        At a ``height`` (m above the cradle) at which it counts as landed nothing: there it is the
        cradle that holds the platform. ``matrix`` (6, n): structure matrix."""
        stop = self._stop
        self._load[:] = external if height > stop.landed else 0.0
        if faults.count:
            unmeasured = (faults.failed & ~faults.cells_trusted & ~faults.torn) | faults.damping
            if unmeasured.any():
                _unexplained(matrix, unmeasured, self._load)
        load = norm(self._load)
        held = min(max(load - stop.load_free, 0.0), stop.load_most) / max(load, stop.load_free)
        return self._load * held

    def pulling(self, tension: Array, faults: Faults) -> Array:
        """Tensions (n,) as far as they are believed: a given-up cable pulls no more than it did
        when that was found, and soon not at all if its drum turns freely; without a cell to say
        so, nothing."""
        if not faults.count or not faults.failed.any():
            self._most[:] = tension
            return tension
        self._pushing[:] = tension < -0.5 * self._stop.taut_tension
        self._most[~faults.failed] = tension[~faults.failed]
        self._most[faults.let_go] *= self._release
        damping = faults.damping
        eased = self._stop.passive_tension + self._release * (
            self._most[damping] - self._stop.passive_tension
        )
        self._most[damping] = eased
        pulls = np.minimum(np.maximum(tension, 0.0), np.maximum(self._most, 0.0))
        pulls[~faults.failed] = tension[~faults.failed]
        pulls[faults.failed & ~faults.cells_trusted] = 0.0
        return pulls

    def felt(self, reference: Array, tension: Array, failed: Mask) -> Array:
        """Tensions (n,) for the loop, which answers a deviation from its ``reference`` (n,) with
        all its gain while a loss throws the platform. Some time after the one cable that ``failed``
        (n,) this fades: drums that yield to every newton yield to a push as well, and sway. Once
        another has failed it is over at once: what is left of the cables does not hold the
        platform's turn, and only drums that resist their own motion damp that."""
        self._thrown += self._period
        if self._thrown > self._stop.throw_s:
            self._eager *= self._calming
        if (failed != self._gone).any():
            self._gone[:] = failed
            several = np.count_nonzero(failed) > 1
            self._eager, self._thrown = 0.0 if several else 1.0, 0.0
        share = self._calm + (1.0 - self._calm) * self._eager
        self._felt[:] = reference + share * (tension - reference)
        return self._felt

    def plan(
        self,
        matrix: Array,
        wrench: Array,
        before: Array,
        tension: Array,
        carrying: Mask,
        faults: Faults,
    ) -> Array:
        """Tension references (n,) for a ``wrench`` (6,), less, in place, what given-up cables pull.
        ``before`` and ``tension`` (n,): the last references, and what `pulling` believes."""
        stop = self._stop
        self.taut &= tension > 0.5 * stop.taut_tension
        self.taut |= tension > stop.taut_tension
        gone = faults.failed
        if gone.any():
            wrench -= matrix[:, gone] @ tension[gone]
        able = carrying & self.taut
        self.centre += (self._period / stop.ease_s) * (stop.passive_tension - self.centre)
        reach, least, most = stop.tension_rate * self._period, stop.least_tension, stop.most_tension
        self._low[:] = np.clip(before - reach, least, most) * able
        self._high[:] = np.clip(before + reach, least, most) * able
        drawn = np.clip(self.centre, least, most) * able
        planned = self.distribution(matrix * able, wrench, drawn, self._low, self._high)
        planned[carrying & ~self.taut] = stop.passive_tension
        self.planned[:] = planned
        throws = self._eager > 0.0 and self._thrown <= stop.pay_out_s
        self._paying[:] = (tension > planned) & (throws and bool(faults.torn.any()))
        return planned

    def bound(
        self,
        torque: Array,
        rate: Array,
        following: Array,
        desired: Array,
        usable: Mask,
        damping: Mask,
    ) -> None:
        """The tension loop's torques (n,) made safe in place, at drum rates (n,) rad/s;
        ``following``: the rates that would follow the platform, ``desired``: those that the loop
        damps against; ``damping`` (n,): drums of given-up cables that damp by themselves, since a
        drum without a torque lets its cable go slack, and snap taut under a heavy drum. They go on
        damping if the cell says that the cable pushes: it does not tell a slack one, and a drum
        that takes up a taut one would pull the platform along."""
        _paid_out(following, desired, self._paying & usable, self.loop.damping, torque)
        if damping.any():
            torque[damping] = self.guard.passive(rate, damping)[damping]
        slack = (usable | damping) & ~self.taut & ~(damping & self._pushing)
        self.taking_up[:] = damping & slack
        self.guard.take_up(torque, rate, following, slack)
        self.guard.bound(torque, rate, usable | damping)
