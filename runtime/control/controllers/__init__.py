"""Controllers by name: each turns an error into the wrench, or the tensions, asked of the cables.

All share estimator, stiffness limiter, tension distribution and (but for `eq9_literal`) the inner
loop, so that a comparison compares controllers and nothing else.
"""

from tonus.runtime.control.controllers.base import Controller, Motion
from tonus.runtime.control.controllers.linear import LinearLaw
from tonus.runtime.control.controllers.registry import (
    CONTROLLERS,
    controller_class,
    make_controller,
)

__all__ = [
    "CONTROLLERS",
    "Controller",
    "LinearLaw",
    "Motion",
    "controller_class",
    "make_controller",
]
