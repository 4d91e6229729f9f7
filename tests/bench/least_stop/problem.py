"""The optimal stop as a nonlinear programme, by implicit midpoint, in two phases.

Early, drums and cables are as they are and the motors' force is the control. Late, when the drums
have caught up, the tensions themselves are the control, bounded in size and rate: this leaves out
vibrations that a step of 20 ms could not show anyway, and lets a slack cable be taken up freely.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from tests.bench.least_stop.grid import UNLOADED, Grid
from tests.bench.least_stop.model import BODY, GEOMETRY, LEFT, STATES, Model
from tests.bench.least_stop.push import NO_PUSH, Push
from tests.bench.least_stop.sparse import Blocks

Array = NDArray[np.float64]
QUIET_S = 0.1
"""s at the end in which the platform is as good as still: no apex of a throw can pass for a stop"""
QUIET_SPEED = 0.03
"""m/s"""
QUIET_RATE = 0.3
"""rad/s"""
_TENSION_RATE = 1500.0
"""N/s in the late phase: half a metre per second of a drum on 3 kN/m of cable"""
_FORCE = 100.0
"""N: scale of controls and tensions"""
_SMOOTH = 5.0e-3
"""weight of mean squares (drums' rates in m/s, ...) against that of the squared speed, 2"""
_CAUTION = 5.0e-4
"""on the second derivative's diagonal: steps do not overshoot where cables go slack"""
_BODY_LIMIT = np.array([2.0] * 3 + [0.6] * 3 + [20.0] * 3 + [60.0] * 3)
"""of every state's size; 0.6 is a turn by 124 degrees"""
CONVERGED = 1.0e-3
"""m/s, m, rad/s: a path that breaks the equations of motion by more in an interval is none"""


@dataclass(frozen=True)
class Case:
    """What a stop begins with."""

    state: Array
    """(26,)"""
    geometry: Array
    """(52,), as the model has it"""
    force: Array
    """N (7,): net of the motors before the break, which go on through the delay"""
    push: Push = NO_PUSH
    lost: Array = field(default_factory=lambda: np.zeros(LEFT))
    """N (7,): what faults take of the motors' driving force"""


@dataclass(frozen=True)
class Solution:
    """One local optimum."""

    peak_speed: float
    """m/s"""
    peak_tension: float
    """N"""
    unknowns: Array
    early: Array
    """states (early nodes, 26)"""
    forces: Array
    """N (early intervals, 7), net of the motors"""
    late: Array
    """platform's states (late intervals, 12), after each of them"""
    tensions: Array
    """N (late intervals, 7)"""
    defect: float
    iterations: int

    @property
    def converged(self) -> bool:
        return self.defect < CONVERGED


class _Unknowns:
    """Names for the parts of the programme's vector, as numpy or CasADi have it."""

    def __init__(self, grid: Grid) -> None:
        n, m = len(grid.early), len(grid.late)
        sizes = ((n + 1) * STATES, n * LEFT, m * BODY, m * LEFT, 1, 1)
        ends = np.concatenate([[0], np.cumsum(sizes)])
        self.size = int(ends[-1])
        place = np.arange(self.size)
        self.states = place[ends[0] : ends[1]].reshape(n + 1, STATES)
        self.forces = place[ends[1] : ends[2]].reshape(n, LEFT)
        self.bodies = place[ends[2] : ends[3]].reshape(m, BODY)
        self.pulls = place[ends[3] : ends[4]].reshape(m, LEFT)
        self.square, self.tension = self.size - 2, self.size - 1
        self.late = np.vstack([self.states[-1:, :BODY], self.bodies])
        """of the late phase's nodes, the first is the early one's last"""


def _taken(z: ca.MX, places: NDArray[np.int64]) -> ca.MX:
    """One column per row of ``places``."""
    return ca.reshape(z[places.ravel().tolist()], places.shape[1], places.shape[0])


class Problem:
    """Least peak speed, and of the stops with this speed one with least peak tension."""

    def __init__(
        self,
        model: Model,
        grid: Grid = UNLOADED,
        *,
        print_level: int = 0,
        iterations: int = 200,
    ) -> None:
        self.model, self.grid = model, grid
        at = self.at = _Unknowns(grid)
        n, m = len(grid.early), len(grid.late)
        z, parameters = ca.MX.sym("z", at.size), ca.MX.sym("p", GEOMETRY + 3 * (n + m) + 2)
        geometry, weights = parameters[:GEOMETRY], parameters[-2:]
        push = ca.reshape(parameters[GEOMETRY:-2], 3, n + m)
        square, tension = z[at.square], z[at.tension]
        states, forces = _taken(z, at.states), _FORCE * _taken(z, at.forces)
        bodies, pulls = _taken(z, at.late), _FORCE * _taken(z, at.pulls)
        middle = 0.5 * (states[:, :-1] + states[:, 1:])
        body_middle = 0.5 * (bodies[:, :-1] + bodies[:, 1:])
        early, late = ca.DM(grid.early).T, ca.DM(grid.late).T
        given = (middle, forces, push[:, :n], ca.repmat(geometry, 1, n))
        body_given = (body_middle, pulls, push[:, n:], ca.repmat(geometry, 1, m))
        motion = model.motion.map(n)(*given)
        body_motion = model.body_motion.map(m)(*body_given)
        defect = states[:, 1:] - states[:, :-1] - motion[:STATES, :] * ca.repmat(early, STATES, 1)
        body_defect = bodies[:, 1:] - bodies[:, :-1] - body_motion * ca.repmat(late, BODY, 1)
        pulled = motion[STATES:, :]
        velocity = ca.horzcat(states[6:9, 1:], bodies[6:9, 1:])
        driven = forces + model.constants.viscous * middle[BODY + LEFT :, :]
        steps = pulls[:, 1:] - pulls[:, :-1]
        joint = pulls[:, 0] - model.tension(states[:, -1], geometry)
        simple = [
            (square - ca.sum1(velocity * velocity), 0.0, np.inf),
            (tension - pulls / _FORCE, 0.0, np.inf),
            (driven / model.constants.driving_force, -1.0, 1.0),
            (steps / _TENSION_RATE / ca.repmat(0.5 * (late[:-1] + late[1:]), LEFT, 1), -1.0, 1.0),
            (joint / _TENSION_RATE / grid.late[0], -1.0, 1.0),
        ]
        nonlinear = [
            (defect, 0.0, 0.0),
            (tension - pulled / _FORCE, 0.0, np.inf),
            (body_defect, 0.0, 0.0),
        ]
        groups = [*nonlinear, *simple]
        g = ca.vertcat(*[ca.vec(rows) for rows, _, _ in groups])
        sizes = [rows.numel() for rows, _, _ in groups]
        self._lowest = np.repeat([low for _, low, _ in groups], sizes)
        self._highest = np.repeat([high for _, _, high in groups], sizes)
        self._defects = np.r_[0 : sizes[0], sum(sizes[:2]) : sum(sizes[:3])]
        self._driven = sum(sizes[:5]) + np.arange(sizes[5]).reshape(n, LEFT)
        rest = ca.vertcat(*[ca.vec(rows) for rows, _, _ in simple])
        smooth = (
            ca.sum1(middle[BODY + LEFT :, :] ** 2) @ early.T / 0.06
            + 0.02 * ca.sum1(body_middle[9:, :] ** 2) @ late.T
            + 0.1 * ca.sumsqr(forces[:, 2:] - forces[:, 1:-1]) / _FORCE**2 / n
            + 0.5 * ca.sumsqr(steps) / _FORCE**2
            + 0.1 * ca.sumsqr(pulls) / _FORCE**2 / m
        )
        objective = weights[0] * square + weights[1] * tension + _SMOOTH * smooth
        blocks = Blocks(sum(sizes[:3]), at.size)
        rows = np.arange(sum(sizes[:3]))
        first = rows[: sizes[0]].reshape(n, STATES)
        second = rows[sizes[0] : sum(sizes[:2])].reshape(n, LEFT)
        third = rows[sum(sizes[:2]) :].reshape(m, BODY)
        lengths, body_scale = np.array(grid.early), -np.array(grid.late)[:, None]
        scale = np.hstack([-np.tile(lengths[:, None], STATES), np.full((n, LEFT), -1.0 / _FORCE)])
        slopes = model.slopes.map(n)(*given)
        body_slopes = model.body_slopes.map(m)(*body_given)
        for side in (0, 1):
            here, there = slice(side, n + side), slice(side, m + side)
            blocks.stages(slopes, scale, np.hstack([first, second]), at.states[here], 0, 0.5)
            blocks.stages(body_slopes, body_scale, third, at.late[there], 0, 0.5)
            blocks.constant(2.0 * side - 1.0, first, at.states[here])
            blocks.constant(2.0 * side - 1.0, third, at.late[there])
        blocks.stages(slopes, scale, np.hstack([first, second]), at.forces, STATES, _FORCE)
        blocks.stages(body_slopes, body_scale, third, at.pulls, BODY, _FORCE)
        blocks.constant(1.0, second, np.full_like(second, at.tension))
        jacobian = ca.vertcat(blocks.matrix(), ca.jacobian(rest, z))
        # Without the curvature of the equations of motion what is left is positive semidefinite,
        # and the programme converges in tens of iterations; the stationary points are the same.
        share, multipliers = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.numel())
        of_speed = multipliers[sum(sizes[:3]) : sum(sizes[:4])]
        lagrangian = share * objective - ca.dot(of_speed, ca.sum1(velocity * velocity).T)
        hessian = ca.triu(ca.hessian(lagrangian, z)[0]) + _CAUTION * ca.MX.eye(at.size)
        options = {
            "print_time": print_level > 0,
            "jac_g": ca.Function("jac_g", [z, parameters], [g, jacobian]),
            "hess_lag": ca.Function("hess_lag", [z, parameters, share, multipliers], [hessian]),
            "ipopt.print_level": print_level,
            "ipopt.sb": "yes",
            "ipopt.max_iter": iterations,
            "ipopt.tol": 1e-5,
            "ipopt.acceptable_tol": 1e-2,
            "ipopt.acceptable_iter": 4,
            "ipopt.acceptable_obj_change_tol": 1e-4,
            "ipopt.acceptable_constr_viol_tol": 1e-4,
            "ipopt.mu_strategy": "adaptive",
            "ipopt.bound_relax_factor": 0.0,
        }
        nlp = {"x": z, "p": parameters, "f": objective, "g": g}
        self._solver = ca.nlpsol("stop", "ipopt", nlp, options)

    def solve(
        self,
        case: Case,
        begin: Array,
        *,
        weights: tuple[float, float],
        speed_limit: float,
        tension_limit: float,
    ) -> Solution:
        """From a vector of unknowns on; ``weights`` of squared peak speed (m2/s2) and of peak
        tension (100 N), which the limits bound."""
        at, constants = self.at, self.model.constants
        low = np.full(at.size, -10.0)
        limit = np.concatenate([_BODY_LIMIT, np.ones(LEFT), np.full(LEFT, constants.reel_limit)])
        low[at.states], low[at.bodies] = -limit, -_BODY_LIMIT
        high = -low
        low[at.pulls], high[at.pulls] = 0.0, tension_limit / _FORCE
        low[at.states[0]] = high[at.states[0]] = case.state
        low[at.forces[0]] = high[at.forces[0]] = case.force / _FORCE
        times = self.grid.times
        quiet = np.vstack([at.states[:, :BODY], at.bodies])[times >= times[-1] - QUIET_S - 1e-9]
        for columns, bound in ((slice(6, 9), QUIET_SPEED), (slice(9, 12), QUIET_RATE)):
            low[quiet[:, columns]], high[quiet[:, columns]] = -bound, bound
        lowest, highest = self._lowest.copy(), self._highest.copy()
        share = np.maximum(0.0, 1.0 - case.lost / constants.driving_force)
        # In the delay the torque is what it was, whatever its drum has lost.
        lowest[self._driven[1:]], highest[self._driven[1:]] = -share, share
        low[at.square], high[at.square] = 0.0, speed_limit**2
        low[at.tension], high[at.tension] = 0.0, tension_limit / _FORCE
        answer = self._solver(
            x0=begin,
            p=np.concatenate([case.geometry, case.push.means(times).ravel(), weights]),
            lbx=low,
            ubx=high,
            lbg=lowest,
            ubg=highest,
        )
        found = np.asarray(answer["x"]).ravel()
        early, late = found[at.states], found[at.bodies]
        speeds = np.concatenate([early[:, 6:9], late[:, 6:9]])
        middle = 0.5 * (early[:-1] + early[1:])
        pulls = _FORCE * found[at.pulls]
        return Solution(
            float(np.linalg.norm(speeds, axis=1).max()),
            float(max(self.tensions(middle, case).max(), pulls.max())),
            found,
            early,
            _FORCE * found[at.forces],
            late,
            pulls,
            float(np.abs(np.asarray(answer["g"]).ravel()[self._defects]).max()),
            int(self._solver.stats()["iter_count"]),
        )

    def tensions(self, states: Array, case: Case) -> Array:
        """N (states, 7)."""
        every = self.model.tension.map(len(states))
        return np.asarray(every(states.T, np.tile(case.geometry[:, None], len(states)))).T

    def unknowns(self, case: Case, states: Array) -> Array:
        """A start that puts ``states`` (nodes, 26) on the nodes of both phases, with the motors in
        balance with the cables; it need not obey the equations of motion."""
        at, n = self.at, len(self.grid.early)
        pulls = np.clip(self.tensions(states, case), 0.0, 150.0)
        z = np.zeros(at.size)
        z[at.states], z[at.bodies] = states[: n + 1], states[n + 1 :, :BODY]
        z[at.forces], z[at.pulls] = pulls[1 : n + 1] / _FORCE, pulls[n + 1 :] / _FORCE
        z[at.square] = (np.linalg.norm(states[:, 6:9], axis=1).max() + 0.05) ** 2
        z[at.tension] = pulls.max() / _FORCE + 0.02
        return z
