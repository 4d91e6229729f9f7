"""Stability margins of an observer that feeds the estimated load forward.

With an exact estimate it would see only what comes from outside. It does not: the external force is
what the cables' pull and the motion leave unexplained, with the mass and the stiffness that the
estimator has been told, and without the cables' own damping, which makes an elongation late. Where
the platform is pulled at some tens of hertz, a cable lengthens many times as far as the platform
moves, so that a few per cent of its stiffness pass for a load of the size of the pull; fed forward,
it pulls again. The loop therefore has the estimator in it, and a plant that differs from what the
estimator knows. It is cut at the load: the margin is that of the observer alone, everything else
closed, at the stiffness at rest.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.axis import DriveTrain
from tonus.config.schema.control import TensionLoop
from tonus.config.schema.root import Config
from tonus.runtime.control.controllers import make_controller
from tonus.runtime.control.controllers.base import share
from tonus.runtime.control.controllers.linear import LinearLaw, NoLinearLawError
from tonus.tools.margins.estimate import EXTERNAL, PLACE, SPEED, STATES, AxisEstimator
from tonus.tools.margins.task import ANGLE, CELL, END, OUTER, Feedback, Loop, least_margins
from tonus.tools.margins.task import PLACE as TRUE_PLACE
from tonus.tools.margins.tension_loop import Margins

Array = NDArray[np.float64]
CUT = "load"


class ObserverLoop(Loop):
    """`Loop` with the estimator in it, and the low-pass of the load."""

    INSIDE = STATES + 1

    def __init__(
        self,
        config: Config,
        tension: TensionLoop,
        outer: LinearLaw,
        axis: int,
        *,
        follows: bool = True,
        train: DriveTrain | None = None,
        mass: float = 1.0,
        axial_stiffness: float = 1.0,
    ) -> None:
        super().__init__(
            config,
            tension,
            outer,
            axis,
            follows=follows,
            train=train,
            mass=mass,
            axial_stiffness=axial_stiffness,
        )
        self._estimator = AxisEstimator(config, self.gather)
        self._integral = outer.contact[1] * config.control.rates.period
        self._taken = share(outer.load_hz, config.control.rates.period)

    def feedback(self, s: Array, load: float | None) -> Feedback:
        o, touch = self.outer, self.outer.body * s[TRUE_PLACE]
        seen = self.radius * s[ANGLE] - s[CELL] / self.stiffness
        state, now = self._estimator.step(s[END:-1], seen, self.gather * s[CELL])
        # What the contact cell accounts for is no load; the cell is taken as exact.
        found = 0.0  # where no load is fed forward: else the low-pass would count as a pole at one
        if self._taken:
            found = s[-1] + self._taken * (now[EXTERNAL] + touch - s[-1])
        grown = s[OUTER] + self._integral * touch if self._integral else 0.0
        force = o.stiffness * now[PLACE] + o.damping * now[SPEED] + o.contact[0] * touch
        force += grown + (found if load is None else load)
        return Feedback(-force, grown, now[SPEED], np.array([*state, found]), found)


def observer_loops(config: Config, controller: str) -> Iterator[ObserverLoop]:
    """Of a controller by name that states the low-pass of a load, else none: over three axes, the
    kinds of drive trains, and the robot as described and at the ends of `control.mismatch`. Raises
    `ControllerError`."""
    law, off = make_controller(controller, config.robot, config.control), config.control.mismatch
    try:
        laws = law.stated_laws()
    except NoLinearLawError:
        return
    ends = {
        (0.0, 0.0),
        *product((-off.mass, off.mass), (-off.axial_stiffness, off.axial_stiffness)),
    }
    for outer in laws:
        if outer.load_hz > 0.0 and outer.stiffness <= law.resting_stiffness:
            for (mass, stiff), train, axis in product(
                sorted(ends), config.robot.kinds_of_axes, range(3)
            ):
                yield ObserverLoop(
                    config,
                    law.tension_loop,
                    outer,
                    axis,
                    follows=law.follows_platform,
                    train=train,
                    mass=1.0 + mass,
                    axial_stiffness=1.0 + stiff,
                )


def observer_margins(config: Config, controller: str) -> Margins | None:
    """The least of a controller by name, cut at the load; None for one without an observer. Raises
    `ControllerError`."""
    found = list(observer_loops(config, controller))
    return least_margins(found, CUT) if found else None
