"""Whether the configured controller can be used: its class, its output, its margins, its time."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from tonus.config import Config
from tonus.config.schema.control import TensionLoop
from tonus.runtime.control.controllers import controller_class
from tonus.runtime.control.controllers.linear import NoLinearLawError
from tonus.runtime.control.controllers.registry import is_foreign
from tonus.runtime.errors import ControllerError
from tonus.tools.check.controller_time import controller_time
from tonus.tools.check.finding import Finding
from tonus.tools.margins.observer import observer_margins
from tonus.tools.margins.probe import Probe
from tonus.tools.margins.task import least_margins, loops, worst_axes
from tonus.tools.margins.tension_loop import Margins

_PROBES = 200
"""motions of one kind"""
_TURN = 0.05
"""of a quaternion's vector part: 6 degrees"""
_UNSTABLE = "unstable: a pole of the closed loop lies outside the unit circle"
_PUSHED = 100.0
"""N, external and desired, in the largest probe: the largest load of the paper"""


def check_controller(config: Config, *, timed: bool = False) -> Iterator[Finding]:
    """``timed``: also measure a controller that is not ours."""
    name = config.control.controller
    try:
        kind = controller_class(name)
        foreign = is_foreign(kind)
        if foreign:
            _probe(config, name)
            text = f"{name} is {kind.__qualname__} of {kind.__module__}, its output is finite"
            yield Finding("controller", True, "control.controller", text, "")
        yield from _whole_loop(config, name, foreign=foreign)
        if foreign and timed:
            yield _time(config, name)
    except ControllerError as error:
        text, remedy = str(error), "correct the class, or choose another controller"
        if "cannot be imported" in text:
            remedy = "put its folder on PYTHONPATH, or install its distribution"
        yield Finding("controller", False, "control.controller", text, remedy)


def _probe(config: Config, name: str) -> None:
    """Raises `ControllerError` where an output is no number or of another shape: at rest, and over
    random motion within the envelope."""
    robot, envelope = config.robot, config.control.envelope
    probe, random = Probe(name, robot, config.control), np.random.default_rng(1)
    probe.begin()
    box = np.array([robot.workspace.x, robot.workspace.y, robot.workspace.z])
    reach = 0.5 * (box[:, 1] - box[:, 0])
    probe.tick(probe.motion())
    for tick, touching in product(range(_PROBES), (0.0, 1.0)):
        scale = (tick + 1) / _PROBES
        drawn = scale * random.uniform(-1.0, 1.0, (7, 3))
        turn = _TURN * drawn[5]
        motion = probe.motion(
            position=np.array(robot.home) + reach * drawn[0],
            velocity=envelope.speed_limit * drawn[1],
            desired_velocity=envelope.speed_limit * drawn[2],
            external=_PUSHED * drawn[3],
            push=touching * envelope.contact_limit * drawn[4],
            contact=touching * envelope.contact_limit * float(abs(drawn[4, 0])),
            quaternion=np.array([np.sqrt(1.0 - float(turn @ turn)), *turn]),
            angular_velocity=drawn[6],
        )
        probe.tick(motion)


def _whole_loop(config: Config, name: str, *, foreign: bool) -> Iterator[Finding]:
    """The configured controller round the tension loop, cut where the torque acts and where the
    force is asked for."""
    floors = config.control.tension_loop
    where = f"control.{name}"
    remedy = f"run tonus tune tension, then tonus tune {name}, or lower its gains"
    how = name
    if foreign:
        where, remedy = "control.controller", "lower its gains"
        how = f"{name}, linearised from its own output"
    try:
        found = loops(config, name)
    except NoLinearLawError as error:
        text = f"{name}: cannot be computed: {error}"
        yield Finding("margins", False, where, text, "state linear_laws in the controller's class")
        return
    for cut in ("torque", "force"):
        text = f"{how}, cut at the {cut}: "
        least = least_margins(found, cut)
        if len(config.robot.kinds_of_axes) > 1:
            text += f"worst{config.robot.whose(worst_axes(found, cut, floors))}, "
        ok = least.meet(floors)
        if name == "eq9_literal":  # is kept because it is
            ok = True
            text += "unstable, as the paper prints it"
        elif not least.stable:
            text += _UNSTABLE
        else:
            text += _told(least, floors)
        yield Finding("margins", ok, where, text, remedy)
    yield from _observer(config, name, where, f"run tonus tune {name}, or lower its cutoff_hz")


def _observer(config: Config, name: str, where: str, remedy: str) -> Iterator[Finding]:
    """An observer of the load, with the estimator in the loop."""
    floors, off = config.control.tension_loop, config.control.mismatch
    least = observer_margins(config, name)
    if least is None:
        return
    how = f"the observer of {name}, cut at the load, "
    how += f"mass {100.0 * off.mass:g} %, EA {100.0 * off.axial_stiffness:g} % and "
    how += f"damping {100.0 * off.damping:g} % off: "
    text = how + (_told(least, floors) if least.stable else _UNSTABLE)
    yield Finding("margins", least.meet(floors), where, text, remedy)


def _told(least: Margins, floors: TensionLoop) -> str:
    phase = f"{least.phase_deg:.1f} deg" if least.phase_deg < np.inf else "no crossing"
    return (
        f"{least.least_gain_db:.1f} dB and {phase}, floors "
        f"{floors.gain_margin_db:g} dB and {floors.phase_margin_deg:g} deg"
    )


def _time(config: Config, name: str) -> Finding:
    taken = controller_time(config, name)
    return Finding(
        "time",
        taken.ok,
        "realtime.controller_share",
        f"{name} takes {100.0 * taken.share:.1f} % of the period of "
        f"{1e6 * taken.period:.0f} us on this host, the limit is {100.0 * taken.limit:g} %",
        "make it faster, or use --virtual",
    )
