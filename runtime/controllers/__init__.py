"""Controllers by name: each turns an error into the wrench, or the tensions, asked of the cables.

All share estimator, stiffness limiter, tension distribution and (but for `eq9_literal`) the inner
loop, so that a comparison compares controllers and nothing else.
"""

from tonus.runtime.controllers.base import Controller, Motion
from tonus.runtime.controllers.bio import Bio, BioIntegral, BioObserver
from tonus.runtime.controllers.cable_length import PidLength
from tonus.runtime.controllers.constant_tension import ConstantTension
from tonus.runtime.controllers.contact_force import ContactForce
from tonus.runtime.controllers.impedance import Pd, PdMatched
from tonus.runtime.controllers.literal import Eq9Literal
from tonus.runtime.controllers.pid import Pid

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
