"""Stability margins of a whole controller: task-space loop round tension loop round plant.

Translation along one axis at home, linear and frictionless, as in
`tonus.tools.margins.tension_loop`: the drums move in the pattern g_i = u_i . d of that axis,
so that they are one drum behind one cable, and G = sum g_i^2 of them pull at the platform. Where
axes differ, each kind is computed as if all were of it, and the worst counts. The estimator is in
the loop, as is the low-pass of a load that a controller feeds forward. It is cut at the torque,
where everything acts, at the force, where the outer loop alone does, and at the load, where an
observer does (`tonus.tools.margins.observer`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.axis import DriveTrain
from tonus.config.schema.control import TensionLoop
from tonus.config.schema.root import Config
from tonus.runtime.control.controllers import make_controller
from tonus.runtime.control.controllers.base import share
from tonus.runtime.control.controllers.linear import LinearLaw, NoLinearLawError
from tonus.runtime.control.controllers.registry import is_foreign
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.control.tension import of_axis
from tonus.tools.margins.estimate import EXTERNAL, PLACE, SPEED, STATES, AxisEstimator
from tonus.tools.margins.hold import zero_order_hold
from tonus.tools.margins.linearisation import LinearResponse, commands_tensions, linear_responses
from tonus.tools.margins.response import frequency_response
from tonus.tools.margins.tension_loop import (
    DELAY_TICKS,
    UNSTABLE,
    Margins,
    frequencies,
    margins_of,
    stable,
)

Array = NDArray[np.float64]
_LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
FREQUENCIES = 3000
"""points of an open loop's response"""
_ANGLE, _CELL, _PLACE = 0, 3, 4
_PLANT = 6
_INTEGRAL, _LAST, _OUTER, _ASKED, _SLOPE, _PIPE = range(_PLANT, _PLANT + 6)
_ESTIMATE = _PIPE + DELAY_TICKS
_LOAD = _ESTIMATE + STATES
_INSIDE = _LOAD + 1
_CUTS = ("torque", "force", "load")


@dataclass(frozen=True)
class Feedback:
    """What the outer loop makes of a state."""

    force: float
    """N, asked of the cables"""
    grown: float
    """the outer integral"""
    speed: float
    """m/s of the platform, as the drums' damping knows it"""
    load: float
    """N, as an observer in the loop knows it"""
    inside: Array
    """what is next inside the estimator, the observer, and a controller given by its response"""


class Loop:
    """The sampled loop as a linear map of its state: plant, tension integral, last drum angle,
    outer integral, last tension reference and its filtered slope, torques under way; the estimator
    and the load fed forward; then what a controller given by its ``response`` has inside."""

    def __init__(
        self,
        config: Config,
        tension: TensionLoop,
        outer: LinearLaw,
        axis: int,
        *,
        follows: bool,
        response: LinearResponse | None = None,
        train: DriveTrain | None = None,
        mass: float = 1.0,
        axial_stiffness: float = 1.0,
        damping: float = 1.0,
    ) -> None:
        """``outer`` is the feedback, or, where there is a ``response``, that is. All cables are
        taken as driven by ``train``; None: by that of axis 0. ``mass``, ``axial_stiffness`` and
        ``damping`` of the cables: the plant's, over those that the controller has been told."""
        self._response = response
        robot, bandwidth = config.robot, config.response
        train = train or robot.drive_trains[0]
        self.axes = robot.kinds_of_axes[train]
        """whose drive train it is"""
        kinematics = Kinematics(robot.geometry)
        kinematics.evaluate(np.array(robot.home), _LEVEL)
        self.gather = gather = float((kinematics.matrix[axis] ** 2).sum())
        self.radius = radius = train.drum.radius
        self._follows = follows
        self._tension = tension = of_axis(tension, train, robot)
        self.outer, self._period = outer, config.control.rates.period
        self.stiffness = train.cable.axial_stiffness / float(kinematics.lengths.mean())
        """N/m of a cable, as it has been told"""
        self._turn = tension.lead / (self.stiffness * radius * self._period)
        """rad/s of the drum for each newton by which the reference moves in a tick"""
        self._follow = 1.0 - np.exp(-2.0 * np.pi * tension.lead_cutoff_hz * self._period)
        k, mass = self.stiffness * axial_stiffness, robot.platform.mass * mass
        c, inertia = train.cable.damping * damping, train.drum.inertia
        self._estimator = AxisEstimator(config, gather, self.stiffness, train.cable.damping)
        self._taken = share(outer.load_hz, self._period)
        """of a tick in the load fed forward"""
        drive = 2.0 * np.pi * bandwidth.current_loop_hz
        cell = 2.0 * np.pi * bandwidth.force_cell_hz
        pull = np.array([k * radius, c * radius, 0.0, 0.0, -k, -c])
        flow = np.zeros((_PLANT, _PLANT))
        flow[0, 1] = flow[4, 5] = 1.0
        flow[1] = -radius / inertia * pull
        flow[1, 1] -= train.drum.viscous_friction / inertia
        flow[1, 2] = 1.0 / inertia
        flow[2, 2] = -drive
        flow[3] = cell * pull
        flow[3, 3] -= cell
        flow[5] = gather / mass * pull
        flow[5, 4] -= outer.body / mass
        enter = np.zeros((_PLANT, 1))
        enter[2] = drive
        self._step, effect = zero_order_hold(flow, enter, self._period)
        self._effect = effect[:, 0]
        self.size = _INSIDE + (response.order if response is not None else 0)

    def feedback(self, s: Array, load: float | None) -> Feedback:
        """Of a state (size,); ``load``: what an observer is to have estimated instead."""
        drum = self.radius * s[_ANGLE]
        state, now = self._estimator.step(s[_ESTIMATE:_LOAD], drum, s[_CELL])
        place, speed = now[PLACE], now[SPEED]
        if self._response is not None:
            force, inside = self._response.step(s[_INSIDE:], place, speed)
            return Feedback(force, 0.0, speed, 0.0, np.array([*state, 0.0, *inside]))
        o, h = self.outer, self._period
        touch = o.body * s[_PLACE]  # the contact cell's, taken as exact
        gains = (o.integral, self.gather * o.cable[2], o.contact[1])
        grown = 0.0
        if any(gains):  # else an integral of nothing would count as a pole at one
            grown = s[_OUTER] + h * float(np.dot(gains, (place, drum, touch)))
        found = 0.0  # the same where no load is fed forward
        if self._taken:  # what the contact cell accounts for is no load
            found = s[_LOAD] + self._taken * (now[EXTERNAL] + touch - s[_LOAD])
        force = o.stiffness * place + o.damping * speed + o.contact[0] * touch
        force += self.gather * (o.cable[0] * drum + o.cable[1] * self.radius * s[_ANGLE + 1])
        force += grown + (found if load is None else load)
        return Feedback(-force, grown, speed, found, np.array([*state, found]))

    def step(
        self,
        s: Array,
        torque: float | None = None,
        force: float | None = None,
        load: float | None = None,
    ) -> tuple[Array, float, float, float]:
        """Next state, and the torque, the force and the load that the loop returns. One of them may
        be given instead: there the loop is cut."""
        t, h, r = self._tension, self._period, self.radius
        back = self.feedback(s, load)
        reference = (back.force if force is None else force) / self.gather
        error = reference - s[_CELL]
        # Else an integral of nothing would count as a pole at one.
        integral = s[_INTEGRAL] + t.integral * h * error if t.integral else 0.0
        asked = r * (t.feed_forward * reference + t.proportional * error + integral)
        rate = (s[_ANGLE] - s[_LAST]) / h
        slope = s[_SLOPE] + self._follow * (reference - s[_ASKED] - s[_SLOPE])
        wanted = self._follows * back.speed / r + self._turn * slope
        asked += t.rate_damping * (wanted - rate)
        new = np.empty(self.size)
        new[:_PLANT] = self._step @ s[:_PLANT] + self._effect * s[_ESTIMATE - 1]
        new[_INTEGRAL], new[_LAST], new[_OUTER] = integral, s[_ANGLE], back.grown
        new[_ASKED], new[_SLOPE] = reference, slope
        new[_PIPE] = asked if torque is None else torque
        new[_PIPE + 1 : _ESTIMATE] = s[_PIPE : _ESTIMATE - 1]
        new[_ESTIMATE:] = back.inside
        return new, asked, back.force, back.load

    def _columns(self, cut: str | None) -> tuple[Array, Array, Array, float]:
        """State matrix, entry, exit and direct part of the loop cut at ``cut``."""
        given = {} if cut is None else {cut: 0.0}
        which = 1 + _CUTS.index(cut or "torque")
        states = [self.step(unit, **given) for unit in np.eye(self.size)]
        matrix = np.array([state[0] for state in states]).T
        out = np.array([state[which] for state in states])
        driven = self.step(np.zeros(self.size), **({} if cut is None else {cut: 1.0}))
        return matrix, driven[0], out, float(driven[which])

    @property
    def stable(self) -> bool:
        return stable(self._columns(None)[0])

    def margins(self, cut: str, points: int = FREQUENCIES) -> Margins:
        matrix, entry, out, direct = self._columns(cut)
        frequency = frequencies(self._period, points)
        z = np.exp(2j * np.pi * frequency * self._period)
        (answer,) = frequency_response(matrix, entry, out[None, :], z)
        return margins_of(-(answer + direct), frequency)


def responses_of(config: Config, controller: str) -> tuple[LinearResponse, ...]:
    """What a controller that is not ours is computed with; the tension loop has no part in it.
    Raises as `loops` does."""
    law = make_controller(controller, config.robot, config.control)
    if is_foreign(type(law)) and not commands_tensions(config, controller):
        return tuple(linear_responses(config, controller))
    return ()


def loops(
    config: Config, controller: str, responses: Sequence[LinearResponse] | None = None
) -> list[Loop]:
    """The loops whose margins are those of a controller by name, with its configured gains: over
    three axes and the ends of its stiffness. A shipped controller is taken by the laws it states;
    any other by its own output, linearised numerically, and by the laws it states besides, or by
    these alone if it commands tensions. Raises `NoLinearLawError` for a controller that neither
    states its feedback nor can be linearised, and `ControllerError` for one that fails.

    ``responses``: those of `responses_of`, where they are known. Bandwidths of drives and cells are
    the lab's, or the robot's where there is none.
    """
    law = make_controller(controller, config.robot, config.control)
    tension, follows = law.tension_loop, law.follows_platform
    if responses is None:
        responses = responses_of(config, controller)
    try:
        laws = law.stated_laws()
    except NoLinearLawError:
        if not responses:
            raise
        laws = ()
    found = []
    for train in config.robot.kinds_of_axes:
        found += [
            Loop(config, tension, outer, axis, follows=follows, train=train)
            for outer in laws
            for axis in range(3)
        ]
        found += [
            Loop(
                config, tension, LinearLaw(), each.axis, follows=follows, response=each, train=train
            )
            for each in responses
        ]
    return found


def least_margins(found: Iterable[Loop], cut: str, points: int = FREQUENCIES) -> Margins:
    """Cut at the ``torque``, the plant's input, every loop counts; at the ``force``, the outer one
    round all others."""
    least = Margins(np.inf, np.inf, 0.0)
    for loop in found:
        if not loop.stable:
            return UNSTABLE
        here = loop.margins(cut, points)
        least = Margins(
            min(least.gain_db, here.gain_db),
            min(least.phase_deg, here.phase_deg),
            max(least.crossover_hz, here.crossover_hz),
            min(least.reduction_db, here.reduction_db),
        )
    return least


def worst_axes(found: Sequence[Loop], cut: str, floors: TensionLoop) -> tuple[int, ...]:
    """The axes whose loops have the least margins against their ``floors``."""
    kinds = dict.fromkeys(loop.axes for loop in found)
    least = {
        axes: least_margins([loop for loop in found if loop.axes == axes], cut) for axes in kinds
    }
    return min(kinds, key=lambda axes: least[axes].reserve(floors))


def margins(config: Config, controller: str, *, cut: str = "torque") -> Margins:
    """The least margins of a controller by name, over its `loops`, with the same errors."""
    return least_margins(loops(config, controller), cut)
