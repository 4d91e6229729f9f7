"""What each axis has: the robot's defaults, and its own in their place."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tonus.config import load
from tonus.config.schema.robot import Robot
from tonus.drivers.devices.drive import Scale

PAPER = load("config/can.yaml")[0].robot


def robot(axes: dict[Any, Any]) -> Robot:
    return load("config/can.yaml", overrides={"robot.axes": axes})[0].robot


ARRAYS = {
    "axial_stiffness": ("cable", "axial_stiffness", 5000.0, 1.0),
    "cable_damping": ("cable", "damping", 7.0, 1.0),
    "drum_radius": ("drum", "radius", 0.03, 1.0),
    "drum_inertia": ("drum", "inertia", 0.008, 1.0),
    "drum_mass": ("drum", "inertia", 0.008, 1.0 / 0.02**2),
    "viscous_friction": ("drum", "viscous_friction", 0.02, 1.0),
    "gear_ratio": ("gearbox", "numerator", 60, 1.0 / 4.0),
    "gearbox_efficiency": ("gearbox", "efficiency", 0.7, 1.0),
    "current_limit": ("motor", "current_limit", 12.0, 1.0),
    "torque_per_amp": ("motor", "torque_constant", 0.1, 49.0 / 4.0),
    "torque_limit": ("motor", "torque_constant", 0.1, 16.0 * 49.0 / 4.0),
    "tension_per_amp": ("motor", "torque_constant", 0.1, 0.8 * 49.0 / 4.0 / 0.02),
    "motor_speed": ("motor", "nominal_speed_rpm", 1500.0, 2.0 * np.pi / 60.0),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_a_value_of_its_own_takes_the_defaults_place_on_its_axis_only(name: str) -> None:
    section, field, value, factor = ARRAYS[name]
    found = getattr(robot({5: {section: {field: value}}}), name)
    default = getattr(PAPER, name)
    assert found.shape == (8,)
    assert found[5] == pytest.approx(value * factor)
    assert found[5] != default[5]
    assert np.array_equal(np.delete(found, 5), np.delete(default, 5))


def test_what_a_robot_gives_is_not_its_own() -> None:
    """A changed array changes no robot; a changed copy of a robot has its own values."""
    PAPER.drum_radius[:] = 1.0
    assert (PAPER.drum_radius == PAPER.drum.radius).all()
    larger = PAPER.model_copy(update={"drum": PAPER.drum.model_copy(update={"radius": 0.04})})
    assert (larger.drum_radius == 0.04).all()


def test_axes_that_differ_in_the_sign_only_are_of_one_kind() -> None:
    own = {"drum": {"radius": 0.025}}
    found = robot({1: own | {"sign": -1}, 2: {"sign": -1}, 6: own, 7: {"drum": {"radius": 0.02}}})
    assert list(found.kinds_of_axes.values()) == [(0, 2, 3, 4, 5, 7), (1, 6)]
    assert found.signs == (1, -1, -1, 1, 1, 1, 1, 1)
    assert found.whose((1, 6)) == " on axes 1, 6"
    assert found.whose((3,)) == " on axis 3"
    assert PAPER.whose(tuple(range(8))) == ""


@pytest.mark.parametrize("axes", [{}, {4: {"sign": -1, "drum": {"radius": 0.025}}, 0: {}}])
def test_a_robot_is_written_as_it_was_stated_and_read_again(axes: dict[int, Any]) -> None:
    found = robot(axes)
    written = found.model_dump(mode="json")
    assert Robot.model_validate(written) == found
    assert Robot.model_validate(found.model_dump()) == found
    assert Robot.model_validate_json(found.model_dump_json()) == found
    assert ("axes" in written) is bool(axes), "a log of a uniform robot is what it was"
    if axes:
        assert written["axes"] == {"4": {"sign": -1, "drum": {"radius": 0.025}}, "0": {"sign": 1}}


def test_one_value_of_an_axis_can_be_set_by_its_dotted_key() -> None:
    path, key = "config/unlike_axes.yaml", "robot.axes.4.drum.radius"
    assert load(path)[0].robot.drum_radius[4] == 0.025
    assert load(path, overrides={key: 0.03})[0].robot.drum_radius[4] == 0.03


def test_a_motor_that_turns_down_has_factors_of_the_other_sign() -> None:
    train = PAPER.drive_trains[0]
    up, down = Scale.of(train, 1), Scale.of(train, -1)
    assert down.radian_per_increment == -up.radian_per_increment < 0.0
    assert down.newton_metre_per_mille == -up.newton_metre_per_mille < 0.0
    assert down.mille_per_newton_metre == -up.mille_per_newton_metre < 0.0
    assert down.mille_limit == up.mille_limit > 0
