"""Stiffness: the model's forces against the published formulas, written here on their own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from plant_setup import (
    KELVIN_VOIGT,
    ROBOT,
    UPRIGHT,
    balanced,
    frictionless,
    placed,
    plant,
    undamped,
    without_cradle,
)

Floats = NDArray[np.float64]


def cross(v: Floats) -> Floats:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def rotation(q: Floats) -> Floats:
    """Rodrigues' formula from the quaternion's axis and angle."""
    v = np.asarray(q[1:])
    return np.eye(3) + 2 * q[0] * cross(v) + 2 * cross(v) @ cross(v)


def times(a: Floats, b: Floats) -> Floats:
    vector = a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
    return np.array([a[0] * b[0] - a[1:] @ b[1:], *vector])


def turned(q: Floats, vector: Floats) -> Floats:
    """q after a further rotation by a small vector in the base frame."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.asarray(q)
    step = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * vector / angle)])
    return times(step, np.asarray(q))


def analytic(position: Floats, q: Floats, tensions: Floats) -> tuple[Floats, Floats]:
    """K_E and K_G with dw = -K dx, x = (position, rotation in the base frame).

    K_E = W diag(EA/L0) W^T;
    K_G = sum T/l [P, -P R; R P, -R P R] + T [0, 0; 0, -U R], P = 1 - u u^T, R = [r]x, U = [u]x.
    """
    elastic, geometric = np.zeros((6, 6)), np.zeros((6, 6))
    turn = rotation(q)
    frame, tips = np.array(ROBOT.geometry.frame), np.array(ROBOT.geometry.platform)
    for anchor, tip, tension in zip(frame, tips, tensions, strict=True):
        r = turn @ tip
        cable = anchor - position - r
        length = float(np.linalg.norm(cable))
        u = cable / length
        unstretched = length / (1 + tension / ROBOT.cable.axial_stiffness)
        column = np.concatenate([u, np.cross(r, u)])
        elastic += ROBOT.cable.axial_stiffness / unstretched * np.outer(column, column)
        p, big_r, big_u = np.eye(3) - np.outer(u, u), cross(r), cross(u)
        block = np.block([[p, -p @ big_r], [big_r @ p, -big_r @ p @ big_r]])
        geometric += tension / length * block
        geometric[3:, 3:] -= tension * big_u @ big_r
    return elastic, geometric


def differences(
    wrench_at: Callable[[Floats, Floats], Floats], position: Floats, q: Floats, step: float = 1e-5
) -> Floats:
    columns = []
    for k in range(6):
        d = np.zeros(6)
        d[k] = step
        ahead = wrench_at(position + d[:3], turned(q, d[3:]))
        behind = wrench_at(position - d[:3], turned(q, -d[3:]))
        columns.append(-(ahead - behind) / (2 * step))
    return np.array(columns).T


POSES = [
    (np.zeros(3), np.array(UPRIGHT)),
    (np.array([0.20, -0.15, 0.12]), turned(np.array(UPRIGHT), np.array([0.1, -0.12, 0.08]))),
    (np.array([-0.24, 0.22, -0.08]), turned(np.array(UPRIGHT), np.array([-0.15, 0.05, 0.1]))),
]


@pytest.mark.parametrize(("position", "q"), POSES)
def test_total_stiffness_is_the_formulas(position: Floats, q: Floats) -> None:
    p = plant(without_cradle())
    tensions = np.array([45.0, 60.0, 30.0, 52.0, 41.0, 77.0, 25.0, 48.0])
    p.place(position, q, tensions)
    assert p.tension == pytest.approx(tensions, rel=1e-9)
    elastic, geometric = analytic(position, q, tensions)
    found = differences(p.wrench, position, q)
    assert np.max(np.abs(found - elastic - geometric)) < 1e-5 * np.max(np.abs(elastic))
    frozen = differences(lambda x, o: p.wrench(x, o, tensions), position, q)
    assert np.max(np.abs(frozen - geometric)) < 1e-5 * np.max(np.abs(geometric))


def test_structure_matrix_gives_the_cables_wrench() -> None:
    p = plant(without_cradle())
    position, q = POSES[1]
    tensions = np.arange(30.0, 70.0, 5.0)
    p.place(position, q, tensions)
    weight = np.array([0, 0, -ROBOT.platform.mass * ROBOT.gravity, 0, 0, 0])
    assert p.structure_matrix() @ tensions + weight == pytest.approx(p.wrench(position, q))


def test_constant_tension_slope_against_the_phantom() -> None:
    """Drives that hold every tension leave the geometric stiffness and the phantom: about
    420 N/m, the paper's passive slope, of which no number is put in."""
    phantom = KELVIN_VOIGT
    p = plant(undamped(without_cradle()), frictionless(), phantom=phantom)
    tensions = balanced(placed(p))
    places = np.linspace(0.0, 0.03, 13)
    forces = [p.wrench((x, 0.0, 0.0), UPRIGHT, tensions)[0] for x in places]
    slope = -np.polyfit(places, forces, 1)[0]
    assert slope == pytest.approx(420.0, rel=0.05)
    _, geometric = analytic(np.zeros(3), np.array(UPRIGHT), tensions)
    assert slope == pytest.approx(geometric[0, 0] + phantom.stiffness, rel=0.01)
    # Unilateral: on the other side only the geometric stiffness is left.
    away = [p.wrench((-x, 0.0, 0.0), UPRIGHT, tensions)[0] for x in places]
    assert np.polyfit(places, away, 1)[0] == pytest.approx(geometric[0, 0], rel=0.01)


def test_modes_with_the_drums_held() -> None:
    p = plant(without_cradle())
    p.place((0.0, 0.0, 0.0), UPRIGHT, np.full(8, 45.0))
    stiffness = differences(p.wrench, np.zeros(3), np.array(UPRIGHT))
    mass = np.diag([ROBOT.platform.mass] * 3 + list(ROBOT.platform.inertia))
    squares = np.linalg.eigvals(np.linalg.solve(mass, stiffness))
    # The expected figures took EA/l for EA/L0, which is 1.25 % softer at 45 N.
    assert np.sort(np.sqrt(squares.real)) / (2 * np.pi) == pytest.approx(
        [9.4, 9.5, 9.5, 12.5, 17.6, 17.6], rel=0.0125
    )
