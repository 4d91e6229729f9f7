"""Controllers by name: each turns an error into the wrench asked of the cables.

All share estimator, stiffness limiter, tension distribution and inner loop, so that a comparison
compares controllers and nothing else.
"""

from runtime.controllers.base import Controller, Motion
from runtime.controllers.bio import Bio
from runtime.controllers.pid import Pid

CONTROLLERS: dict[str, type[Controller]] = {"bio": Bio, "pid": Pid}

__all__ = ["CONTROLLERS", "Controller", "Motion"]
