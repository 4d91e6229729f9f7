"""Robots and labs for the plant's tests: the shipped ones, with parts of the physics left out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tonus.config import load
from tonus.config.schema.lab import Backlash, Lab, Phantom, Stiffening, Stribeck
from tonus.config.schema.robot import Robot
from tonus.sim.plant import Plant

CONFIG, SCENARIO = load(
    str(Path(__file__).parents[2] / "config" / "can.yaml"), scenario="load_test"
)
assert CONFIG.lab is not None
ROBOT: Robot = CONFIG.robot
LAB: Lab = CONFIG.lab
UPRIGHT = (1.0, 0.0, 0.0, 0.0)
TICK_NS = 1_000_000
KELVIN_VOIGT = Phantom(
    point=(0.0, 0.0, 0.0),
    normal=(-1.0, 0.0, 0.0),
    model="kelvin_voigt",
    stiffness=210.0,
    damping=8.0,
    relaxing_stiffness=105.0,
    relaxation_time=0.5,
)
STRIBECK = Stribeck(share=0.2, speed=0.01)
BACKLASH = Backlash(play_deg=0.7, rotor_share=0.8, stiffness=1000.0, damping=0.5)
STIFFENING = Stiffening(tension=45.0, share=0.4)
PULLEY_RADIUS = 0.04
OPTIONS: dict[str, dict[str, Any]] = {
    "none": {},
    "pulleys": {"pulley_radius": PULLEY_RADIUS},
    "stiffening cables": {"stiffening": STIFFENING},
    "Stribeck friction": {"stribeck": STRIBECK},
    "backlash": {"backlash": BACKLASH},
}


def with_plant(lab: Lab = LAB, **changes: Any) -> Lab:
    return lab.model_copy(update={"plant": lab.plant.model_copy(update=changes)})


def frictionless(lab: Lab = LAB) -> Lab:
    return with_plant(lab, coulomb_friction=0.0, load_friction=0.0, gearbox_losses=False)


def undamped(robot: Robot = ROBOT) -> Robot:
    return robot.model_copy(
        update={
            "cable": robot.cable.model_copy(update={"damping": 0.0}),
            "drum": robot.drum.model_copy(update={"viscous_friction": 0.0}),
        }
    )


def without_cradle(robot: Robot = ROBOT) -> Robot:
    return robot.model_copy(update={"rest": (0.0, 0.0, -100.0)})


def plant(robot: Robot = ROBOT, lab: Lab = LAB, **arguments: Any) -> Plant:
    return Plant(robot, lab, **({"seed": 1, "phantom": None, "load": None} | arguments))


def balanced(p: Plant, tension: float = 45.0) -> np.ndarray:
    """Tensions near an even one that carry the platform's weight at its present pose."""
    wanted = np.array([0.0, 0.0, ROBOT.platform.mass * ROBOT.gravity, 0.0, 0.0, 0.0])
    matrix = p.structure_matrix()
    even = np.full(8, tension)
    return even + np.linalg.pinv(matrix) @ (wanted - matrix @ even)


def placed(p: Plant, position: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Plant:
    """In equilibrium at a pose, motors powered with constant current."""
    p.position[:] = position
    p.place(position, UPRIGHT, balanced(p))
    return p


def run(p: Plant, seconds: float) -> None:
    """Advance by whole ticks, as the lab does."""
    for _ in range(round(seconds * 1000)):
        p.advance(p.now_ns + TICK_NS)
