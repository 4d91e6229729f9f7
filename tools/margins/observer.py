"""Stability margins of an observer that feeds the estimated load forward.

The external force is what the cables' pull and the motion leave unexplained, with the mass, the
stiffness and the damping of the cables that the estimator has been told. Where the platform is
pulled at some tens of hertz, a cable lengthens many times as far as the platform moves, so that a
few per cent of its stiffness pass for a load of the size of the pull; fed forward, it pulls again.
So the plant differs from what the estimator knows. The loop is cut at the load: the margin is that
of the observer alone, everything else closed, at the stiffness at rest.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

from tonus.config.schema.root import Config
from tonus.runtime.control.controllers import make_controller
from tonus.runtime.control.controllers.linear import NoLinearLawError
from tonus.tools.margins.task import Loop, least_margins
from tonus.tools.margins.tension_loop import Margins

CUT = "load"


def observer_loops(config: Config, controller: str) -> Iterator[Loop]:
    """Of a controller by name that states the low-pass of a load, else none: over three axes, the
    kinds of drive trains, and the robot as described and at the ends of `control.mismatch`. Raises
    `ControllerError`."""
    law, off = make_controller(controller, config.robot, config.control), config.control.mismatch
    try:
        laws = law.stated_laws()
    except NoLinearLawError:
        return
    shares = (off.mass, off.axial_stiffness, off.damping)
    ends = {(0.0, 0.0, 0.0), *product(*((-share, share) for share in shares))}
    for outer in laws:
        if outer.load_hz > 0.0 and outer.stiffness <= law.resting_stiffness:
            for (mass, stiff, damping), train, axis in product(
                sorted(ends), config.robot.kinds_of_axes, range(3)
            ):
                yield Loop(
                    config,
                    law.tension_loop,
                    outer,
                    axis,
                    follows=law.follows_platform,
                    train=train,
                    mass=1.0 + mass,
                    axial_stiffness=1.0 + stiff,
                    damping=1.0 + damping,
                )


def observer_margins(config: Config, controller: str) -> Margins | None:
    """The least of a controller by name, cut at the load; None for one without an observer. Raises
    `ControllerError`."""
    found = list(observer_loops(config, controller))
    return least_margins(found, CUT) if found else None
