"""What is really so: the record against which a run in the lab is judged.

The table is written like the daemon's signals (name, type, size, unit, meaning) but shares no code
with them. The plant's state begins with exactly these fields, so that filling a record is one copy.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

PER_CABLE = -1
"""In place of a size: one value for each cable."""
TRUTH_TABLE: tuple[tuple[str, str, int, str, str], ...] = (
    ("position", "float64", 3, "m", "platform origin in the base frame"),
    ("quaternion", "float64", 4, "", "w x y z, platform to base"),
    ("velocity", "float64", 3, "m/s", "of the platform origin"),
    ("angular_velocity", "float64", 3, "rad/s", "base frame"),
    ("tension", "float64", PER_CABLE, "N", "true tension of every cable"),
    ("drum_angle", "float64", PER_CABLE, "rad", "since the start, reeling in positive"),
    ("drum_rate", "float64", PER_CABLE, "rad/s", "reeling in positive"),
    ("current", "float64", PER_CABLE, "A", "motor current, reeling in positive"),
    ("load", "float64", 6, "N, N m", "force and moment of load port and push, base frame"),
    ("cut", "float64", PER_CABLE, "", "1 for a cable that is cut, else 0"),
    ("contact_force", "float64", 0, "N", "of the phantom on the contact port, along its normal"),
    ("contact_penetration", "float64", 0, "m", "depth of the contact port in the phantom"),
    ("kinetic", "float64", 0, "J", "of platform and drums"),
    ("potential", "float64", 0, "J", "of the platform's weight, zero at the base frame's origin"),
    ("strain", "float64", 0, "J", "of the free cables, and of the gearboxes' teeth"),
    ("phantom", "float64", 0, "J", "of the phantom's springs"),
    ("cradle", "float64", 0, "J", "of the cradle's springs"),
    ("wound", "float64", 0, "J", "account of cable reeled in and out under tension, see Energy"),
    ("losses", "float64", 0, "J", "dissipated since the start"),
    ("friction_losses", "float64", 0, "J", "the drums' share: bearings, gearboxes, brakes"),
    ("cable_losses", "float64", 0, "J", "the share of the cables' damping"),
    ("copper_losses", "float64", 0, "J", "in the windings since the start, not part of losses"),
    ("input_work", "float64", 0, "J", "done by the motors' torque since the start"),
    ("load_work", "float64", 0, "J", "done by load port, push and moving phantom since the start"),
    ("platform_power", "float64", 0, "W", "of the cables on the platform"),
    ("electrical_power", "float64", 0, "W", "the motors' mechanical power and copper losses"),
)
"""Name, type, size (0: scalar), unit, meaning; widest first, as a CDR body wants it."""


@cache
def truth_fields(cables: int) -> tuple[tuple[str, str, int, str, str], ...]:
    """The table for a robot with so many cables."""
    return tuple(
        (name, kind, cables if size == PER_CABLE else size, unit, meaning)
        for name, kind, size, unit, meaning in TRUTH_TABLE
    )


@cache
def truth_dtype(cables: int) -> np.dtype[np.void]:
    """One record, packed little-endian in the table's order, without padding."""
    return np.dtype(
        [
            (name, "<" + np.dtype(kind).str[1:], (size,) if size else ())
            for name, kind, size, _, _ in truth_fields(cables)
        ]
    )


_WORD = np.dtype("<f8")


def words(record: NDArray[Any]) -> NDArray[np.float64]:
    """A ``np.zeros(1, truth_dtype(n))`` as one flat vector, which `Plant.truth` is too."""
    return record.view(_WORD)
