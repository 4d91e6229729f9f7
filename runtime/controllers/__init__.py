"""Controllers by name: each turns an error into the wrench, or the tensions, asked of the cables.

All share estimator, stiffness limiter, tension distribution and (but for `eq9_literal`) the inner
loop, so that a comparison compares controllers and nothing else.
"""

from runtime.controllers.base import Controller, Motion
from runtime.controllers.bio import Bio, BioIntegral, BioObserver
from runtime.controllers.cable_length import PidLength
from runtime.controllers.constant_tension import ConstantTension
from runtime.controllers.contact_force import ContactForce
from runtime.controllers.impedance import Pd, PdMatched
from runtime.controllers.literal import Eq9Literal
from runtime.controllers.pid import Pid

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

__all__ = ["CONTROLLERS", "Controller", "Motion"]
