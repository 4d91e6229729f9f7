"""What the numbers of states and other enumerations are called, as info, events and pages do."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.drivers.process_image import AxisCommand, AxisState
from tonus.runtime.recording.payloads import Level
from tonus.runtime.signals import Bound, Consistency, Grade, Solver
from tonus.runtime.states import Fault, Operator, State, StopMode
from tonus.tools.log.log import EVENTS

SUFFIX = "_name"
"""what the column of names adds to the name of the numbers"""
ENUMERATIONS: Mapping[tuple[str, str], type[IntEnum]] = {
    ("/tonus/state", "state"): State,
    ("/tonus/state", "fault"): Fault,
    ("/tonus/state", "stop_mode"): StopMode,
    ("/tonus/state", "operator"): Operator,
    ("/tonus/drives", "state"): AxisState,
    ("/tonus/drives", "command"): AxisCommand,
    ("/tonus/pose", "consistency"): Consistency,
    ("/tonus/tension", "solver"): Solver,
    ("/tonus/envelope", "grade"): Grade,
    ("/tonus/envelope", "bound"): Bound,
    (EVENTS, "level"): Level,
}
"""By topic and field; a test holds it against the table of signals."""


def name_of(member: IntEnum) -> str:
    """The robot's states in capitals, everything else in small letters."""
    return member.name if isinstance(member, State) else member.name.lower()


def named(
    enumeration: type[IntEnum], numbers: NDArray[Any]
) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    """Numbers of any shape as places in a list of names, and the list; one that has no name, as a
    log of another version may hold, is named by its digits."""
    known = {int(member): name_of(member) for member in enumeration}
    different, places = np.unique(numbers, return_inverse=True)
    names = tuple(known.get(int(number), str(int(number))) for number in different)
    return places.reshape(numbers.shape), names


def longest(enumeration: type[IntEnum]) -> int:
    """Characters of its longest name; those of an unknown number are fewer."""
    return max(5, *(len(member.name) for member in enumeration))
