"""One controller played by itself: what it answers to a given motion, examined as it comes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.control import Control
from tonus.config.schema.robot import Robot
from tonus.runtime.control.controllers.base import LEVEL, Motion
from tonus.runtime.control.controllers.registry import make_controller
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.errors import ControllerError

Array = NDArray[np.float64]


class Probe:
    """A new controller, and the ticks it has been asked for, in the order of the control cycle."""

    def __init__(self, name: str, robot: Robot, control: Control) -> None:
        """Raises `ControllerError`."""
        self._name, self._control = name, control
        self._period = control.rates.period
        self._controller = make_controller(name, robot, control)
        kinematics = Kinematics(robot.geometry)
        home = np.array(robot.home)
        kinematics.evaluate(home, LEVEL)
        self._lengths = kinematics.lengths.copy()
        self._home = home
        self._centre = np.full(len(self._lengths), control.tension.pre)
        self._ticks = 0
        self.commands_tensions = False
        """whether it has answered with tensions and not with a wrench"""

    def motion(self, **changes: Any) -> Motion:
        """At rest at home, but for the ``changes``."""
        rest: dict[str, Any] = {
            "desired_position": self._home.copy(),
            "position": self._home.copy(),
            "quaternion": LEVEL.copy(),
            "contact": 0.0,
            "wound": self._lengths.copy(),
            "winding": np.zeros(len(self._lengths)),
        }
        names = ("desired_velocity", "desired_acceleration", "velocity", "angular_velocity")
        for name in (*names, "external", "shortfall", "push"):
            rest[name] = np.zeros(3)
        return Motion(**(rest | changes))

    def displaced(self, offset: Array, velocity: Array) -> Motion:
        """``offset`` (3,) m away from home, at a ``velocity`` (3,) m/s."""
        return self.motion(position=self._home + offset, velocity=velocity)

    def begin(self) -> None:
        """As the cycle does before motion starts. Raises `ControllerError`."""
        try:
            self._controller.reset()
        except Exception as error:
            raise self._raised("reset", error) from error

    def stiffness(self, motion: Motion) -> float:
        """N/m that the controller asks for. Raises `ControllerError`."""
        try:
            with np.errstate(all="ignore"):  # what comes of it is examined
                asked = float(self._controller.stiffness(motion))
        except Exception as error:
            raise self._raised("stiffness", error) from error
        self._examine("stiffness", np.array(asked), ())
        return asked

    def tick(self, motion: Motion, stiffness: float | None = None) -> Array:
        """Wrench (6,) at a ``stiffness`` in N/m; None: at what the controller asks for, within
        bounds. Raises `ControllerError` for an exception, another shape, or what is no number."""
        controller, bounds = self._controller, self._control.stiffness
        asked = self.stiffness(motion)
        if stiffness is None:
            stiffness = min(max(asked, bounds.minimum), bounds.maximum)
        try:
            with np.errstate(all="ignore"):
                wrench = np.asarray(controller.wrench(motion, stiffness), float)
                tensions = controller.tensions(motion, stiffness, self._centre.copy())
                controller.applied(self._centre.copy(), self._ticks * self._period)
        except Exception as error:
            raise self._raised("a tick", error) from error
        self._ticks += 1
        self._examine("wrench", wrench, (6,))
        if tensions is not None:
            self.commands_tensions = True
            self._examine("tensions", np.asarray(tensions, float), self._centre.shape)
        return wrench

    def _examine(self, what: str, values: Array, shape: tuple[int, ...]) -> None:
        if values.shape != shape:
            text = f"its {what} has the shape {values.shape}, not {shape}"
            raise ControllerError(f"controller {self._name}: {text}")
        if not np.isfinite(values).all():
            raise ControllerError(f"controller {self._name}: its {what} is not finite")

    def _raised(self, where: str, error: Exception) -> ControllerError:
        said = f"{type(error).__name__}: {error}"
        return ControllerError(f"controller {self._name}: {where} raised {said}")
