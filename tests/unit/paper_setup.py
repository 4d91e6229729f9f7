"""Trials and results of the paper's protocol made up by formula, so that what must come out is
known on paper."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from config import load
from config.schema.root import Config
from config.schema.scenario import Path as Way
from config.schema.scenario import Scenario, Waypoint
from runtime.reference import trajectory
from tools.paper.case import Case, Kind, Run
from tools.paper.trial import Trial

CONFIG: Config = load(str(Path(__file__).parents[2] / "config" / "direct.yaml"))[0]
BASE = CONFIG.control.stiffness.base
TENSION = 45.0


def scenario(reference: dict[str, Any], duration: float) -> Scenario:
    return Scenario.model_validate(
        {"name": "made_up", "description": "", "duration": duration, "reference": reference}
    )


def still(kind: Kind, reference: dict[str, Any] | None = None, duration: float = 4.0) -> Trial:
    """A platform that follows its reference to the micrometre, all tensions even."""
    script = scenario(reference or {"kind": "hold"}, duration)
    n = round(duration * 1000) + 1
    time = np.arange(n) * 1e-3
    wanted, home = trajectory(script.reference), np.array(CONFIG.robot.home)
    desired = home + np.array([wanted(float(t))[0] for t in time])
    zeros = np.zeros(n)
    truth: dict[str, NDArray[Any]] = {
        "position": desired.copy(),
        "quaternion": np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        "velocity": np.gradient(desired, 1e-3, axis=0),
        "tension": np.full((n, 8), TENSION),
        "drum_rate": np.zeros((n, 8)),
        "current": np.zeros((n, 8)),
        "load": np.zeros((n, 6)),
        **{
            name: zeros.copy()
            for name in (
                *("contact_force", "contact_penetration", "platform_power", "electrical_power"),
                *("friction_losses", "cable_losses", "copper_losses"),
            )
        },
    }
    cycle: dict[str, NDArray[Any]] = {
        "state.scenario_time": time.copy(),
        "pose.desired_position": desired,
        "stiffness.k_eq": np.full(n, BASE),
        "stiffness.measured": np.full(n, BASE),
        "tension.reference": np.full((n, 8), TENSION),
        "wrench.commanded": np.zeros((n, 6)),
        "wrench.deficit": zeros.copy(),
        "energy.stiffening": zeros.copy(),
        "energy.dissipated": zeros.copy(),
        "energy.tank": np.full(n, 0.1),
        "drives.torque_command": np.zeros((n, 8)),
    }
    run = Run(Case(2, "made_up", kind, script), "bio", "lab", 1, "direct")
    return Trial(run, CONFIG, time, cycle, truth, "STANDBY", "completed", "")


def sine(amplitude: float, frequency: float) -> dict[str, Any]:
    return {
        "kind": "sine",
        "direction": [0.0, 0.0, 1.0],
        "amplitude": amplitude,
        "frequency": frequency,
        "fade": 2.0,
    }


def steps(step: float) -> dict[str, Any]:
    way = Way(
        kind="path",
        waypoints=(
            Waypoint(position=(step, 0.0, 0.0), duration=0.5, pause=1.5),
            Waypoint(position=(0.0, 0.0, 0.0), duration=0.5, pause=1.5),
        ),
    )
    return way.model_dump()
