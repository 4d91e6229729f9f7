"""Cables with pulleys and with stiffness that grows: against geometry and slopes found here."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from plant_setup import (
    PULLEY_RADIUS as RADIUS,
)
from plant_setup import (
    ROBOT,
    STIFFENING,
    UPRIGHT,
    frictionless,
    placed,
    plant,
    undamped,
    with_plant,
    without_cradle,
)
from scipy.optimize import brentq

from tonus.sim.errors import LabError
from tonus.sim.plant import Plant

Floats = NDArray[np.float64]
PLACES = [(0.0, 0.0, 0.0), (0.22, -0.15, 0.18), (-0.2, 0.24, -0.19)]


def round_the_pulley(anchor: Floats, tip: Floats) -> float:
    """Length from the point where the cable comes up to the pulley: the rim is followed in small
    chords up to the point from which the way to the tip is a tangent."""
    outward = (tip - anchor) * [1.0, 1.0, 0.0]
    outward /= np.linalg.norm(outward)
    centre = anchor + RADIUS * outward
    up = np.array([0.0, 0.0, 1.0])

    def rim(angle: Floats | float) -> Floats:
        angle = np.asarray(angle)[..., None]
        return centre + RADIUS * (-np.cos(angle) * outward + np.sin(angle) * up)

    def leaving(angle: float) -> float:
        """Zero where the spoke is square to the straight part."""
        return float((rim(angle) - centre) @ (tip - rim(angle)))

    # From below, the first tangent that runs on in the sense in which the cable came.
    angles = np.linspace(0.0, np.pi, 2001)
    signs = np.sign([leaving(a) for a in angles])
    for k in np.flatnonzero(np.diff(signs)):
        angle = brentq(leaving, angles[k], angles[k + 1], xtol=1e-13)
        onward = np.sin(angle) * outward + np.cos(angle) * up
        if onward @ (tip - rim(angle)) > 0.0:
            break
    chords = np.diff(rim(np.linspace(0.0, angle, 20_001)), axis=0)
    return float(np.sum(np.linalg.norm(chords, axis=1)) + np.linalg.norm(tip - rim(angle)))


@pytest.mark.parametrize("place", PLACES)
def test_a_cable_over_a_pulley_is_as_long_as_the_way_it_takes(
    place: tuple[float, float, float],
) -> None:
    p = plant(without_cradle(), with_plant(pulley_radius=RADIUS))
    p.position[:] = place
    frame, tips = np.array(ROBOT.geometry.frame), np.array(ROBOT.geometry.platform)
    wanted = [round_the_pulley(a, np.array(place) + b) for a, b in zip(frame, tips, strict=True)]
    assert p.cable_lengths() == pytest.approx(wanted, abs=1e-8)
    straight = np.linalg.norm(frame - place - tips, axis=1)
    assert np.min(np.abs(p.cable_lengths() - straight)) > 1e-3


def test_a_cable_over_a_pulley_pulls_along_the_gradient_of_its_length() -> None:
    p = plant(without_cradle(), with_plant(pulley_radius=RADIUS))
    for place in PLACES:
        gradient = []
        for k in range(3):
            lengths = []
            for side in (1.0, -1.0):
                p.position[:] = place
                p.position[k] += side * 1e-6
                lengths.append(p.cable_lengths())
            gradient.append((lengths[0] - lengths[1]) / 2e-6)
        p.position[:] = place
        assert p.structure_matrix()[:3] == pytest.approx(-np.array(gradient), abs=1e-8)


def test_a_tiny_pulley_is_no_pulley() -> None:
    tiny, none = plant(lab=with_plant(pulley_radius=1e-9)), plant()
    assert tiny.cable_lengths() == pytest.approx(none.cable_lengths(), abs=1e-8)
    assert tiny.structure_matrix() == pytest.approx(none.structure_matrix(), abs=1e-8)


def test_pulleys_that_reach_the_platform_are_refused() -> None:
    with pytest.raises(LabError, match=r"lab\.plant\.pulley_radius: .* choose less than 0\.\d+"):
        plant(lab=with_plant(pulley_radius=0.7))


def slopes(p: Plant) -> tuple[Floats, Floats]:
    """dT/dl of every cable, small, by winding; and the unstretched lengths."""
    angle, step = p.drum_angle.copy(), 1e-4
    tensions = []
    for side in (1.0, -1.0):
        p.drum_angle[:] = angle + side * step
        p.advance(p.now_ns + 1)
        tensions.append(p.tension.copy())
    free = p.parameters["start_length"][0] - ROBOT.drum.radius * angle
    # Winding in by dx stretches by dx and leaves dx (1 + strain) less: dT = EA_t (l/L0^2) dx.
    gradient = (tensions[0] - tensions[1]) / (2 * step * ROBOT.drum.radius)
    return gradient * free / p.cable_lengths(), free


@pytest.mark.parametrize("tension", [10.0, 45.0, 90.0, 180.0])
def test_a_stiffening_cables_small_signal_slope_grows_with_its_tension(tension: float) -> None:
    p = plant(undamped(without_cradle()), with_plant(frictionless(), stiffening=STIFFENING))
    p.place((0.0, 0.0, 0.0), UPRIGHT, np.full(8, tension))
    assert p.tension == pytest.approx(np.full(8, tension), rel=1e-9)
    found, free = slopes(p)
    axial = ROBOT.cable.axial_stiffness * (1.0 - 0.4 + 0.4 * tension / 45.0)
    assert found == pytest.approx(axial / free, rel=1e-5)


def test_at_its_reference_tension_a_stiffening_cable_is_the_configured_one() -> None:
    found = []
    for option in ({}, {"stiffening": STIFFENING}):
        p = plant(undamped(without_cradle()), with_plant(frictionless(), **option))
        p.place((0.0, 0.0, 0.0), UPRIGHT, np.full(8, 45.0))
        slope, free = slopes(p)
        found.append(slope * free)
    assert found[0] == pytest.approx(found[1], rel=1e-5)
    assert found[0] == pytest.approx(np.full(8, ROBOT.cable.axial_stiffness), rel=1e-5)


@pytest.mark.parametrize("option", [{"pulley_radius": RADIUS}, {"stiffening": STIFFENING}])
def test_a_cable_that_is_cut_loses_just_what_it_stored(option: dict[str, object]) -> None:
    p = placed(plant(undamped(), with_plant(frictionless(), **option)))
    start = p.energy()
    p.cut_cable(2)
    assert p.energy().losses > 0.01
    assert p.energy().balance == pytest.approx(start.balance, abs=1e-12)
