"""Inertia, friction and gearbox of every drum: where a motor's torque goes.

    winding against the motor's torque, τ ω > 0:   τ = (J α + b ω + r T (1 + μ) + r F_c) / η
    driven back by the cable,           τ ω < 0:   τ = (J α + b ω + r T (1 − μ) − r F_c) η'

η and η' can be told from μ because they also scale J α, and μ does not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tonus.runtime.states import State
from tonus.tools.identify.estimate import Estimate, Fit, each_of, fit, mean_of, numbered, per_kind
from tonus.tools.identify.record import UNLIKE_DELAY_TICKS, Record

Array = NDArray[np.float64]
_STATES = (State.PRETENSION, State.HOLD, State.ACTIVE)
_SLOWEST = 0.01
"""m/s of cable: below, friction may be anything up to its limit, or Stribeck's"""
_FEWEST = 500
"""samples in either direction"""


_ROWS = (
    ("drum_inertia", "drum inertia J", "kg m²", "robot.drum.inertia"),
    ("viscous_friction", "viscous friction b", "N m s/rad", "robot.drum.viscous_friction"),
    ("coulomb_friction", "Coulomb friction F_c", "N", "lab.plant.coulomb_friction"),
    ("load_friction", "load friction μ", "", "lab.plant.load_friction"),
    ("efficiency_driving", "gearbox, driving η", "", "robot.gearbox.efficiency"),
    ("efficiency_driven", "gearbox, driven back η'", "", "robot.gearbox.efficiency"),
)
"""Name, text, unit and default's key of what a drum's fit gives, in the order of its parameters."""


@dataclass(frozen=True)
class Drum:
    """One drum while it turned, over all records: arrays (n,), smoothed alike."""

    radius: float
    block: NDArray[np.int64]
    jerk: Array
    acceleration: Array
    rate: Array
    torque: Array
    tension: Array
    tension_rate: Array

    def corrected(self, *, encoder: float = 0.0, cell: float = 0.0) -> Drum:
        """As if encoder or cell told everything this much (s) too late."""
        return replace(
            self,
            acceleration=self.acceleration + encoder * self.jerk,
            rate=self.rate + encoder * self.acceleration,
            tension=self.tension + cell * self.tension_rate,
        )

    @property
    def friction(self) -> Array:
        """N m: what neither tension nor inertia explains."""
        return self.torque - self.radius * self.tension

    def torque_of(self, p: Array) -> Array:
        """The model's torque for parameters (6,): J, b, F_c, μ, η, η'."""
        inertia, viscous, coulomb, load, driving, driven = p
        moved = inertia * self.acceleration + viscous * self.rate + self.radius * self.tension
        held = self.radius * (load * self.tension + coulomb)
        winding = self.torque * self.rate > 0.0
        return np.asarray(np.where(winding, (moved + held) / driving, (moved - held) * driven))


def gather(records: Sequence[Record], cable: int) -> Drum:
    """What all records say about one drum."""
    columns: tuple[list[Array], ...] = ([], [], [], [], [], [])
    blocks: list[NDArray[np.int64]] = []
    radius = float(records[0].config.robot.drum_radius[cable])
    for record in records:
        rate = record.smooth(np.gradient(record.angle[:, cable], record.period))
        turning = np.abs(rate) * radius > _SLOWEST
        chosen = record.inner(record.during(*_STATES) & turning)
        tension = record.smooth(record.tension[:, cable])
        acceleration = np.gradient(rate, record.period)
        values = (
            np.gradient(acceleration, record.period),
            acceleration,
            rate,
            record.smooth(record.torque[:, cable]),
            tension,
            np.gradient(tension, record.period),
        )
        for column, value in zip(columns, values, strict=True):
            column.append(value[chosen])
        blocks.append(record.blocks[chosen])
    joined = [np.concatenate(column) for column in columns]
    return Drum(radius, numbered(blocks), *joined)


def fit_drum(drum: Drum) -> Fit | None:
    """J, b, F_c, μ, η, η'; None when it turned too little either way."""
    forth = int(np.count_nonzero(drum.torque * drum.rate > 0.0))
    if min(forth, len(drum.rate) - forth) < _FEWEST:
        return None
    return fit(
        lambda p: drum.torque_of(p) - drum.torque,
        np.array([1e-3, 1e-2, 1.0, 0.0, 0.9, 0.9]),
        drum.block,
        scale=np.array([1e-3, 1e-2, 1.0, 1e-2, 1e-1, 1e-1]),
    )


def _again(drums: Sequence[Drum], fits: Sequence[Fit | None], **late: float) -> list[Fit | None]:
    """The fits, had encoder or cell been late."""
    return [
        found and (fit_drum(drum.corrected(**late)) or found)
        for drum, found in zip(drums, fits, strict=True)
    ]


def identify_drums(records: Sequence[Record]) -> tuple[list[Estimate], list[tuple[Drum, Fit]]]:
    """Inertia, friction and efficiencies, and every drum that could be fitted; both empty when
    none could."""
    every = tuple(range(records[0].config.robot.cables))
    drums = [gather(records, cable) for cable in every]
    fits = [fit_drum(drum) for drum in drums]
    fitted = [(drum, found) for drum, found in zip(drums, fits, strict=True) if found is not None]
    if not fitted:
        return [], []
    config = records[0].config
    robot, lab = config.robot, config.lab
    coulomb = lab.plant.coulomb_friction if lab else None
    load = lab.plant.load_friction if lab else None
    of_lab = {"coulomb_friction": coulomb, "load_friction": load}
    delay = UNLIKE_DELAY_TICKS * records[0].period
    skewed = [_again(drums, fits, encoder=delay), _again(drums, fits, cell=delay)]
    estimates = []
    for index, (name, text, unit, place) in enumerate(_ROWS):
        section, field = place.split(".")[-2:]
        kinds = [(every, place, of_lab[name])] if name in of_lab else None
        for axes, key, configured in kinds or per_kind(robot, section, field, fits):
            some = [fits[axis] for axis in axes]
            value, half_width = mean_of(some, index)
            moved = (mean_of([other[axis] for axis in axes], index)[0] for other in skewed)
            half_width = math.hypot(half_width, *(new - value for new in moved))
            estimates.append(
                Estimate(
                    name,
                    f"{text}{robot.whose(axes)}",
                    unit,
                    value,
                    half_width,
                    configured,
                    each_of(some, index),
                    key=key,
                    axes=axes,
                )
            )
    return estimates, fitted
