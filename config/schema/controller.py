"""How a configuration names a controller: a shipped one, an entry point, or ``module:Class``."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from pydantic import AfterValidator
from pydantic_core import PydanticCustomError

from tonus.config.schema.outside import names_object, registered

ENTRY_POINTS = "tonus.controllers"
"""the group in which an installed distribution registers its controllers"""

ControllerName = Literal[
    "bio",
    "bio_integral",
    "bio_observer",
    "pd",
    "pd_matched",
    "pid",
    "pid_length",
    "force",
    "eq9_literal",
    "constant_tension",
]
"""the shipped ones"""
SHIPPED: tuple[str, ...] = get_args(ControllerName)


def _known(name: str) -> str:
    if name in SHIPPED or names_object(name):
        return name
    others = registered(ENTRY_POINTS)
    if name not in others:
        known = ", ".join(repr(each) for each in (*SHIPPED, *others))
        raise PydanticCustomError(
            "literal_error",
            "Input should be {known} or package.module:Class",
            {"known": known},
        )
    return name


ControllerChoice = Annotated[str, AfterValidator(_known)]
"""Whether the class can be imported is for `tonus.runtime.control.controllers.registry` to say."""
