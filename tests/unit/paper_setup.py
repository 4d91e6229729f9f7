"""Trials and results of the paper's protocol made up by formula, so that what must come out is
known on paper."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.config import load
from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Path as Way
from tonus.config.schema.scenario import Scenario, Waypoint
from tonus.runtime.control.reference import trajectory
from tonus.tools.paper.case import Case, Kind, Run
from tonus.tools.paper.results import Results, Row, Traces
from tonus.tools.paper.trial import Trial

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
        "envelope.grade": np.zeros(n, np.uint8),
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


CONTROLLERS = ("bio", "bio_observer", "pd", "pd_matched", "pid")
SEEDS = (1, 2, 3)
CASES: dict[str, tuple[int, Kind, dict[str, float]]] = {
    "sine_z_30mm_0.5Hz": (2, Kind.SINE, {"frequency_hz": 0.5, "amplitude": 0.03}),
    "sine_x_10mm_1Hz": (2, Kind.SINE, {"frequency_hz": 1.0, "amplitude": 0.01}),
    "move_x_10mm": (2, Kind.MOVE, {}),
    "ramp_x": (3, Kind.RAMP, {}),
    "step_z": (3, Kind.STEP, {}),
    "contact": (3, Kind.CONTACT, {}),
    "press": (3, Kind.PRESS, {}),
    "hold": (2, Kind.HOLD, {}),
}
FACTOR = {"bio": 0.9, "bio_observer": 0.5, "pd": 1.2, "pd_matched": 1.1, "pid": 1.0}
"""every error of a controller over that of PID"""
BASES: dict[Kind, dict[str, float]] = {
    Kind.SINE: {
        "position_rmse": 1e-4,
        "phase_lag_deg": 0.5,
        "energy_per_period": 10.0,
        "moment_rmse": 0.03,
        "tension_percent_max": 1.0,
        "effort": 3.0,
        "eq13_broken_percent": 2.0,
    },
    Kind.MOVE: {"overshoot_percent": 2.0, "overshoot_worst_percent": 2.2},
    Kind.RAMP: {
        "load_deviation_peak": 0.02,
        "load_deviation_end": 0.01,
        "vibration_0_10hz": 0.01,
        "tension_spread": 10.0,
        "eq13_broken_percent": 2.0,
    },
    Kind.STEP: {
        "load_deviation_peak": 0.008,
        "load_deviation_end": 0.004,
        "force_peak": 30.0,
        "vibration_0_10hz": 0.01,
        "tension_spread": 10.0,
        "eq13_broken_percent": 2.0,
    },
    Kind.CONTACT: {},
    Kind.PRESS: {"contact_force_rmse": 0.5},
    Kind.HOLD: {"tension_percent": 0.1},
}


def made_up(key: str, case: str, controller: str, plant: str, seed: int) -> Row:
    """Its errors: FACTOR times the seed's share of the base."""
    stage, kind, told = CASES[case]
    share = 1.0 + (0.0 if plant == "model" else 0.01 * seed)
    factor = FACTOR[controller] * share
    own = {name: value * factor for name, value in BASES[kind].items()}
    common = {
        "slack_ticks": 0.0,
        "violation_ticks": 0.0,
        "violation_longest": 0.0,
        "k_eq_min": 3210.0,
        "k_eq_max": 4000.0,
        "k_eq_mean": 3500.0,
        "k_eq_outside_ticks": 0.0,
        "tension_rmse": 0.1,
        "envelope_enabled": 1.0,
        "contact_peak": 23.0,
        "stiffness_deviation_percent": 6.0 * factor,
    }
    if kind is Kind.SINE:
        own["efficiency_percent"] = 10.0 / factor
    if kind is Kind.MOVE:
        own.update(settling=0.6 * factor, settling_worst=0.61 * factor)
    if kind is Kind.STEP and controller.startswith("bio"):
        own["reaction"] = 0.041
    if kind in (Kind.RAMP, Kind.STEP):
        own["k_eq_at_end"] = 3788.0
    return Row(
        *(key, stage, case, kind, controller, plant, seed, "direct"),
        indicators={**common, **own, **told},
        state="STANDBY",
        reason="completed",
    )


def campaign() -> Results:
    """Five controllers, eight cases, a model and three seeds of the lab; and its curves."""
    rows = [
        made_up(f"{case}.{controller}.{plant}.direct.seed{seed}", case, controller, plant, seed)
        for case in CASES
        for controller in CONTROLLERS
        for plant, seeds in (("model", (1,)), ("lab", SEEDS))
        for seed in seeds
    ]
    slope = {"slope": 418.0, "slope_loading": 419.0, "slope_unloading": 417.0, "travel": 0.03}
    rows += [
        Row(
            *(f"slope.{plant}", 1, "slope", Kind.SLOPE, "constant_tension", plant, 1, "direct"),
            indicators=slope,
        )
        for plant in ("model", "lab")
    ]
    rows.append(
        Row(
            *("open", 3, "contact_open", Kind.CONTACT, "bio", "lab", 1, "direct"),
            indicators={"contact_peak": 41.0, "envelope_enabled": 0.0, "violation_ticks": 900.0},
        )
    )
    rows.append(
        Row(
            *("eq9", 3, "eq9", Kind.HOLD, "eq9_literal", "lab", 1, "direct"),
            indicators={"tension_percent": 60.0},
            state="FAULT",
            reason="slack at cable 3",
            fault="slack",
        )
    )
    rows += [
        Row(
            *(f"plant-{n}", 0, "short", Kind.SINE, "bio", f"plant-{n:03d}", n, "direct"),
            indicators={
                "position_rmse": 1e-3 * (0.2 + 0.005 * n),
                "slack_ticks": 0.0,
                "violation_longest": 0.0,
            },
        )
        for n in range(200)
    ]
    return Results(rows, curves)


def curves(key: str) -> Traces | None:
    """Curves of a trial in the rough shape of what the real ones look like."""
    if not key.endswith("seed1") and key not in ("slope.model", "slope.lab", "open", "eq9"):
        return None
    time = np.arange(1500) * 4e-3
    zero, three = np.zeros(1500), np.zeros((1500, 3))
    factor = next((FACTOR[name] for name in FACTOR if f".{name}." in key), 1.0)
    lab = 1.0 if ".lab." in key else 0.0
    wave = np.sin(2 * np.pi * 0.5 * time)
    found = {
        "time": time,
        "position": three.copy(),
        "desired": three.copy(),
        "load": three.copy(),
        "velocity": three.copy(),
        "cable_force": np.tile([0.0, 0.0, 23.0], (1500, 1)),
        "k_eq": np.full(1500, 3210.0),
        "contact": zero.copy(),
        "contact_wanted": zero.copy(),
        "tension": np.full((1500, 8), 45.0),
        "scenario_time": time,
    }
    if "sine" in key or "move" in key or "hold" in key:
        found["desired"][:, 2] = 0.03 * wave
        found["position"][:, 2] = 0.03 * wave + lab * 1e-4 * factor * np.cos(9 * time)
    elif "ramp" in key or "step" in key:
        load = np.clip(20.0 * (time - 1.0), 0.0, 100.0)
        found["load"][:, 0] = load if "ramp" in key else 25.0 * (time > 1.0)
        found["position"][:, 0] = 2.6e-4 * factor * found["load"][:, 0]
        found["k_eq"] += 6.0 * found["load"][:, 0]
    elif "contact" in key or "press" in key or key == "open":
        top = 41.0 if key == "open" else 23.0
        found["contact"] = np.clip(12.0 * (time - 2.0), 0.0, top)
        found["contact_wanted"] = np.clip(12.0 * (time - 2.0), 0.0, 20.0)
    elif "slope" in key:
        way = 0.03 * (1.0 - np.abs(time / 3.0 - 1.0))
        found["position"][:, 2] = -way
        rubbing = 1.5 * np.sign(np.gradient(way)) * ("lab" in key)
        found["load"][:, 2] = -(418.0 * way + rubbing)
    else:
        found["tension"] += 30.0 * np.sin(40.0 * time[:, None] + np.arange(8))
    found["cable_force"][:, 0] -= found["load"][:, 0]
    found["cable_force"][:, 2] += 2.35 * np.gradient(np.gradient(found["position"][:, 2])) / 1.6e-5
    return found
