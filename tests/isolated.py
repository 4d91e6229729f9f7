"""Faults of cables, drums, motors and sensors, one at a time: what the robot takes each for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from tests.torn import Motion, Stopped, Torn, tear
from tonus.runtime.states import Fault
from tonus.sim.plant import Plant

_SLIPPING = 0.02
"""s in which a cable slips"""
_PUSH = 100.0
"""N"""


@dataclass(frozen=True)
class Broken:
    """A fault of the plant at a cable."""

    kind: str
    """of `tonus.config.faults`"""
    size: str
    breaking: Callable[[Plant, int], object]
    names: frozenset[Fault]
    """what it may be taken for: names that point at the right part"""
    motions: tuple[Motion, ...] = ("rest", "towards")
    push: float = 0.0
    """N"""

    def right(self, case: Stopped) -> bool:
        """Named and placed."""
        return Fault[case.fault] in self.names and case.where == case.cable


def _faults() -> Iterator[Broken]:
    torn = frozenset({Fault.CABLE_TORN})
    length = {Fault.LENGTH_JUMP, Fault.LENGTH_DRIFT, Fault.DRUM_TORQUE, Fault.DRUM_STUCK}
    measured = frozenset({*length, Fault.TENSION_ERROR})
    driven = frozenset({Fault.TENSION_ERROR, Fault.DRUM_TORQUE, Fault.DRUM_STUCK})
    yield Broken("cable_cut", "", tear, torn)
    yield Broken("cable_cut", f"under {_PUSH:g} N", tear, torn, ("rest",), _PUSH)
    for metres in (0.002, 0.005, 0.020):
        yield Broken(
            "drum_slip",
            f"{1e3 * metres:g} mm",
            lambda plant, cable, m=metres: plant.defects.slip_drum(cable, m, _SLIPPING),
            frozenset(length),
        )
    yield Broken(
        "drum_jam",
        "",
        lambda plant, cable: plant.defects.jam_drum(cable),
        frozenset({*driven, Fault.LENGTH_DRIFT}),
        ("towards",),
    )
    for force in (5.0, 20.0, 60.0):
        yield Broken(
            "drum_friction",
            f"{force:g} N",
            lambda plant, cable, f=force: plant.defects.rub_drum(cable, f),
            driven,
        )
    for share in (0.7, 0.3, -1.0):
        yield Broken(
            "motor_weak",
            f"gain {share:g}",
            lambda plant, cable, g=share: plant.defects.weaken_motor(cable, g),
            driven,
        )
    for gain in (0.5, 0.8, 1.2, 2.0):
        yield Broken(
            "cell_gain",
            f"{gain:g}",
            lambda plant, cable, g=gain: plant.defects.scale_cell(cable, g),
            measured,
        )
    for offset in (5.0, 20.0):
        yield Broken(
            "cell_offset",
            f"{offset:g} N",
            lambda plant, cable, f=offset: plant.defects.offset_cell(cable, f),
            measured,
        )
    yield Broken(
        "cell_frozen",
        "",
        lambda plant, cable: plant.defects.freeze_cell(cable),
        frozenset({*measured, Fault.CELL_FROZEN}),
    )
    for angle in (0.05, 0.25, 1.0):
        yield Broken(
            "encoder_slip",
            f"{angle:g} rad",
            lambda plant, cable, a=angle: plant.defects.slip_encoder(cable, a),
            frozenset(length),
        )
    yield Broken(
        "encoder_frozen",
        "",
        lambda plant, cable: plant.defects.freeze_encoder(cable),
        frozenset(length),
        ("towards",),
    )


BROKEN = tuple(_faults())


def play(robot: Torn, broken: Broken, cable: int) -> Iterator[Stopped]:
    """A fault at a cable in each of its motions."""
    if broken.push:
        yield robot.pushed(cable, broken.push, broken.breaking)
    else:
        yield from robot.cases(cable, broken.motions, broken.breaking)
