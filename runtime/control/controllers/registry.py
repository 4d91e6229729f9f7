"""From a controller's name to the controller: the shipped ones, entry points, ``module:Class``."""

from __future__ import annotations

from tonus.config.schema.control import Control
from tonus.config.schema.controller import ENTRY_POINTS
from tonus.config.schema.outside import OutsideError, imported, names_object, registered
from tonus.config.schema.robot import Robot
from tonus.runtime.control.controllers.base import Controller
from tonus.runtime.control.controllers.bio import Bio, BioIntegral, BioObserver
from tonus.runtime.control.controllers.cable_length import PidLength
from tonus.runtime.control.controllers.constant_tension import ConstantTension
from tonus.runtime.control.controllers.contact_force import ContactForce
from tonus.runtime.control.controllers.impedance import Pd, PdMatched
from tonus.runtime.control.controllers.literal import Eq9Literal
from tonus.runtime.control.controllers.pid import Pid
from tonus.runtime.errors import ControllerError

CONTROLLERS: dict[str, type[Controller]] = {
    "bio": Bio,
    "bio_integral": BioIntegral,
    "bio_observer": BioObserver,
    "pd": Pd,
    "pd_matched": PdMatched,
    "pid": Pid,
    "pid_length": PidLength,
    "force": ContactForce,
    "eq9_literal": Eq9Literal,
    "constant_tension": ConstantTension,
}
"""the shipped ones; an entry point of the same name does not replace one"""
_OURS = __name__.rpartition(".")[0] + "."
_OF_THE_STOP = ("descent", "_levelled")
"""methods that every controller shares, since a stop uses them"""


def controller_class(name: str) -> type[Controller]:
    """The class of that name, imported if need be. Raises `ControllerError`."""
    if name in CONTROLLERS:
        return CONTROLLERS[name]
    if not names_object(name) and name not in registered(ENTRY_POINTS):
        known = ", ".join((*CONTROLLERS, *registered(ENTRY_POINTS)))
        raise ControllerError(f"controller {name}: not installed; choose one of {known}")
    try:
        found = imported(ENTRY_POINTS, name)
    except OutsideError as error:
        raise ControllerError(f"controller {name}: {error}") from error
    path = getattr(found, "__qualname__", name.rpartition(":")[2])
    if not isinstance(found, type) or not issubclass(found, Controller):
        raise ControllerError(f"controller {name}: {path} is not a subclass of tonus.Controller")
    for method in _OF_THE_STOP:
        if getattr(found, method) is not getattr(Controller, method):
            raise ControllerError(f"controller {name}: {path} replaces {method}, which a stop uses")
    return found


def make_controller(name: str, robot: Robot, control: Control) -> Controller:
    """A new controller of that name. Raises `ControllerError`."""
    kind = controller_class(name)
    if not is_foreign(kind):
        return kind(robot, control)
    try:
        return kind(robot, control)
    except Exception as error:
        raise ControllerError(f"controller {name}: cannot be made: {_said(error)}") from error


def is_foreign(kind: type[Controller]) -> bool:
    """Whether the class is defined outside this package."""
    return not kind.__module__.startswith(_OURS)


def _said(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"
