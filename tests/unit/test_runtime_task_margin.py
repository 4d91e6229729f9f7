"""Stability margins of whole controllers at the plant's input."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tonus.config import load
from tonus.runtime.control.controllers import CONTROLLERS
from tonus.runtime.control.kinematics import Kinematics
from tonus.tools.margins.task import margins
from tonus.tools.margins.tension_loop import tension_loop_margins

CONFIG, _ = load("config/can.yaml")
FLOOR = CONFIG.control.tension_loop


@pytest.mark.parametrize("name", [name for name in CONTROLLERS if name != "eq9_literal"])
@pytest.mark.parametrize("cut", ["torque", "force"])
def test_every_controller_meets_the_floors_wherever_it_is_cut(name: str, cut: str) -> None:
    found = margins(CONFIG, name, cut=cut)
    assert found.gain_db >= FLOOR.gain_margin_db
    assert found.phase_deg >= FLOOR.phase_margin_deg


def test_equation_9_as_printed_is_unstable() -> None:
    assert margins(CONFIG, "eq9_literal").gain_db == -math.inf


def test_with_an_unmoving_platform_only_the_tension_loop_is_left() -> None:
    """The other computation of its margins, for one cable and a fixed end, agrees. The outer loop's
    damping, which grows with the mass, acts on the estimated speed, and so on the tensions."""
    overrides = {"robot.platform.mass": 1.0e5, "control.pd.damping_ratio": 1.0e-4}
    config, _ = load("config/can.yaml", overrides=overrides)
    kinematics = Kinematics(config.robot.geometry)
    kinematics.evaluate(np.array(config.robot.home), np.array([1.0, 0.0, 0.0, 0.0]))
    lab = config.lab
    assert lab is not None
    alone = tension_loop_margins(
        config.robot.drive_trains[0],
        config.control.tension_loop,
        config.control.rates.period,
        cable_length=float(kinematics.lengths.mean()),
        current_loop_hz=lab.plant.current_loop_hz,
        cell_bandwidth_hz=lab.noise.force_cell.bandwidth_hz,
    )
    whole = margins(config, "pd")
    assert whole.gain_db == pytest.approx(alone.gain_db, abs=0.05)
    assert whole.phase_deg == pytest.approx(alone.phase_deg, abs=0.5)


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("pid", "control.pid.integral.gain", 2.0e5),
        ("pid_length", "control.pid_length.derivative", 60.0),
        ("force", "control.force.integral", 3000.0),
        ("pd", "control.pd.damping_ratio", 0.05),
    ],
)
def test_a_gain_beyond_reason_leaves_no_margin(name: str, key: str, value: float) -> None:
    config, _ = load("config/can.yaml", overrides={key: value})
    found = margins(config, name)
    assert found.gain_db < FLOOR.gain_margin_db or found.phase_deg < FLOOR.phase_margin_deg


def test_it_is_the_lead_that_gives_the_outer_loop_its_phase() -> None:
    config, _ = load("config/can.yaml", overrides={"control.tension_loop.lead": 0.0})
    without, with_it = (margins(each, "bio", cut="force") for each in (config, CONFIG))
    assert without.phase_deg < 0.5 * FLOOR.phase_margin_deg
    assert with_it.phase_deg > without.phase_deg + 20.0


def test_a_stiffer_spring_leaves_the_outer_loop_less_margin() -> None:
    found = []
    for stiffness in (2000.0, 4000.0, 7000.0):
        integral = {"gain": 8000.0, "limit": 120.0}
        pid = {"stiffness": stiffness, "damping_ratio": 0.8, "integral": integral}
        config, _ = load("config/can.yaml", overrides={"control.pid": pid})
        found.append(margins(config, "pid", cut="force").phase_deg)
    assert found == sorted(found, reverse=True)
