"""The true robot as one record: the configured one and what the seed makes of it."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, pi, radians, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.lab import Backlash, Displacement, Lab, Load, Phantom, Stiffening
from tonus.config.schema.robot import Robot
from tonus.sim.errors import LabError
from tonus.sim.plant.layout import parameters_dtype

Floats = NDArray[np.float64]
_COARSEST = 0.5
"""rad of the teeth's vibration per step, beyond which the integrator distorts it"""
_STANDING = 4
"""corners on which a platform lies flat"""


def _unit(vector: Sequence[float], what: str) -> Floats:
    direction = np.array(vector, dtype=np.float64)
    length = float(np.linalg.norm(direction))
    if length == 0.0:
        raise ValueError(f"{what} has no direction")
    return direction / length


def parameters(
    robot: Robot, lab: Lab, anchors: Floats, random: np.random.Generator
) -> NDArray[Any]:
    """One record of `parameters_dtype` without phantom and load. ``anchors`` (n, 3) are the frame's
    true ones. Draws the same numbers whatever is configured. Raises `LabError`."""
    record = np.zeros(1, parameters_dtype(robot.cables))
    plant, cradle = lab.plant, lab.cradle
    ways = anchors - np.array(robot.rest) - np.array(robot.geometry.platform)
    shortest = float(np.min(np.linalg.norm(ways, axis=1)))
    if 2.0 * plant.pulley_radius >= shortest:
        raise LabError(
            f"lab.plant.pulley_radius: pulleys of {plant.pulley_radius:g} m reach the platform at "
            f"rest; choose less than {0.5 * shortest:.2f}"
        )
    stiffness = 1.0 + plant.stiffness_spread * random.uniform(-1.0, 1.0, robot.cables)
    friction = 1.0 + plant.friction_spread * random.uniform(-1.0, 1.0, robot.cables)
    scale = plant.mass_scale * (1.0 + plant.mass_spread * random.uniform(-1.0, 1.0))
    weight = robot.platform.mass * scale * robot.gravity
    tips = np.array(robot.geometry.platform, dtype=np.float64)
    low = tips[:, 2].min()
    # Driven backwards, a gearbox of efficiency eta holds the cable with motor torque / eta.
    efficiency = robot.gearbox_efficiency if plant.gearbox_losses else np.ones(robot.cables)
    values = {
        "mass": robot.platform.mass * scale,
        "inertia": np.array(robot.platform.inertia) * scale,
        "gravity": robot.gravity,
        "anchors": anchors,
        "tips": robot.geometry.platform,
        "pulley_radius": plant.pulley_radius,
        "axial_stiffness": robot.axial_stiffness * plant.stiffness_scale * stiffness,
        "cable_damping": robot.cable_damping * plant.damping_scale,
        "radius": robot.drum_radius,
        "drum_inertia": robot.drum_inertia,
        "viscous": robot.viscous_friction,
        "coulomb": plant.coulomb_friction * robot.drum_radius * friction,
        "load_friction": plant.load_friction * friction,
        # A motor that is locked by hand, in a test, is held by anything.
        "brake_torque": [train.brake_torque or inf for train in robot.drive_trains],
        "teeth_stiffness": inf,
        "driving_loss": 1.0 - efficiency,
        "driven_loss": 1.0 / efficiency - 1.0,
        "torque_per_amp": robot.torque_per_amp,
        "resistance": plant.winding_resistance,
        "ratio": robot.gear_ratio,
        "sign": robot.signs,
        "current_limit": robot.current_limit,
        "current_pole": 2.0 * pi * plant.current_loop_hz,
        "cell_pole": 2.0 * pi * lab.noise.force_cell.bandwidth_hz,
        "cradle_place": robot.rest,
        "cradle_radius": cradle.radius,
        "cradle_depth": cradle.depth,
        "cradle_friction": cradle.friction,
        "corner_stiffness": cradle.stiffness / _STANDING,
        "corner_damping": cradle.damping / _STANDING,
        "box_half": np.abs(tips[:, :2]).max(axis=0),
        "box_ends": (low, tips[:, 2].max()),
        # The cups' bottoms are so high that the platform lies at `rest` exactly.
        "table_height": robot.rest[2] + low + weight / cradle.stiffness + cradle.depth,
        "cell_gain": 1.0,
        "encoder_gain": 1.0,
        "opening": 0.5,
    }
    for name, value in values.items():
        record[name] = value
    if plant.stribeck is not None:
        record["stribeck"] = plant.stribeck.share
        record["stribeck_rate"] = plant.stribeck.speed / robot.drum_radius
    if plant.stiffening is not None:
        _stiffen(record, plant.stiffening)
    if plant.backlash is not None:
        _divide(record, plant.backlash, plant.substep_us * 1e-6)
    return record


def _stiffen(record: NDArray[Any], stiffening: Stiffening) -> None:
    """EA as configured holds at the stated tension; this share of it grows with tension."""
    record["stiffening"] = record["axial_stiffness"] * stiffening.share / stiffening.tension
    record["axial_stiffness"] *= 1.0 - stiffening.share


def _divide(record: NDArray[Any], backlash: Backlash, step: float) -> None:
    """Make rotor and drum two bodies with the play between them. Raises `LabError`."""
    share = backlash.rotor_share
    reduced = share * (1.0 - share) * float(record["drum_inertia"][0].min())
    if step * sqrt(backlash.stiffness / reduced) > _COARSEST:
        finest = 1e6 * _COARSEST / sqrt(backlash.stiffness / reduced)
        raise LabError(
            f"lab.plant.backlash: teeth of {backlash.stiffness:g} N m/rad vibrate too fast for "
            f"substep_us {step * 1e6:g}; set it to {finest:.0f} or less, or choose softer teeth"
        )
    record["backlash"] = 1.0
    record["half_play"] = 0.5 * radians(backlash.play_deg)
    record["teeth_stiffness"] = backlash.stiffness
    record["teeth_damping"] = backlash.damping
    for of_both, of_rotor in (
        ("drum_inertia", "rotor_inertia"),
        ("viscous", "rotor_viscous"),
        ("coulomb", "rotor_coulomb"),
    ):
        record[of_rotor] = share * record[of_both]
        record[of_both] *= 1.0 - share


def add_phantom(record: NDArray[Any], phantom: Phantom) -> None:
    """Put a phantom where there was none."""
    solid = phantom.model == "standard_linear_solid"
    second = phantom.relaxing_stiffness if solid else 0.0
    record["contact"] = 1.0
    record["contact_point"] = phantom.point
    record["contact_normal"] = _unit(phantom.normal, "the phantom's normal")
    record["contact_stiffness"] = phantom.stiffness
    record["contact_damping"] = 0.0 if solid else phantom.damping
    record["relaxing_stiffness"] = second
    record["relaxation_rate"] = 1.0 / phantom.relaxation_time
    record["solid"] = float(solid)
    if solid:
        balance = phantom.stiffness / (phantom.stiffness + second)
        record["recovery_rate"] = balance / phantom.relaxation_time
    else:
        damping = phantom.damping
        record["recovery_rate"] = phantom.stiffness / damping if damping > 0.0 else inf


def clearance(phantom: Phantom, positions: Floats) -> Floats:
    """m (n,) in front of a phantom's surface of the contact port at ``positions`` (n, 3)."""
    normal = _unit(phantom.normal, "the phantom's normal")
    return np.asarray((positions - np.array(phantom.point)) @ normal)


def add_load(record: NDArray[Any], load: Load) -> None:
    """Direction and point; the profile is the caller's."""
    record["load_direction"] = _unit(load.direction, "the load")
    record["load_point"] = load.point


def take_hold(record: NDArray[Any], displacement: Displacement, position: Floats) -> None:
    """Have the load port grip the platform where it is; the profile is the caller's."""
    record["load_direction"] = _unit(displacement.direction, "the displacement")
    record["grip_stiffness"] = displacement.stiffness
    record["grip_damping"] = displacement.damping
    record["grip_origin"] = position


def let_go(record: NDArray[Any]) -> None:
    """End the grip."""
    record["grip_stiffness"] = 0.0


def strain(record: NDArray[Any], tension: Floats) -> Floats:
    """Of every cable (n,) under these tensions: the inverse of the elastic law."""
    stiffness, growth = record["axial_stiffness"][0], record["stiffening"][0]
    if not growth.any():
        return np.asarray(tension / stiffness)
    return np.asarray(np.log1p(growth * tension / stiffness) / growth)
