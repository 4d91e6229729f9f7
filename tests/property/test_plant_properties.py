"""Whatever the drives do, the plant stays mechanics: accounts close, nothing pushes on a rope."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tonus.config import load
from tonus.config.schema.lab import Backlash, Phantom, Stiffening, Stribeck
from tonus.sim.plant import Plant

CONFIG, SCENARIO = load(str(Path(__file__).parents[2] / "config" / "can.yaml"), scenario="contact")
amps = st.lists(st.floats(-3.0, 12.0), min_size=8, max_size=8)
switches = st.lists(st.booleans(), min_size=8, max_size=8)
phase = st.tuples(amps, switches, switches, st.integers(1_000, 40_000_000))
phantoms = st.one_of(
    st.none(),
    st.builds(
        Phantom,
        point=st.tuples(*[st.floats(-0.05, 0.05)] * 3),
        normal=st.sampled_from([(-1.0, 0.0, 0.0), (0.0, 0.6, -0.8), (0.0, 0.0, -1.0)]),
        model=st.sampled_from(["kelvin_voigt", "standard_linear_solid"]),
        stiffness=st.floats(100.0, 2000.0),
        damping=st.floats(0.0, 20.0),
        relaxing_stiffness=st.floats(0.0, 500.0),
        relaxation_time=st.floats(0.1, 2.0),
    ),
)
options = st.fixed_dictionaries(
    {
        "stribeck": st.none()
        | st.builds(Stribeck, share=st.floats(0.05, 1.0), speed=st.floats(0.005, 0.1)),
        "backlash": st.none()
        | st.builds(
            Backlash,
            play_deg=st.floats(0.1, 2.0),
            rotor_share=st.floats(0.3, 0.8),
            stiffness=st.floats(100.0, 1500.0),
            damping=st.floats(0.0, 0.5),
        ),
        "stiffening": st.none()
        | st.builds(Stiffening, tension=st.floats(20.0, 100.0), share=st.floats(0.05, 0.6)),
        "pulley_radius": st.sampled_from([0.0, 0.02, 0.05]),
        "stiffness_spread": st.floats(0.0, 0.15),
        "friction_spread": st.floats(0.0, 1.0),
        "mass_spread": st.floats(0.0, 0.2),
    }
)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.lists(phase, min_size=1, max_size=12), phantoms, options, st.integers(0, 1000))
def test_any_drive_history(
    phases: list[tuple[list[float], list[bool], list[bool], int]],
    phantom: Phantom | None,
    option: dict[str, Any],
    seed: int,
) -> None:
    assert CONFIG.lab is not None
    lab = CONFIG.lab.model_copy(update={"plant": CONFIG.lab.plant.model_copy(update=option)})
    p = Plant(CONFIG.robot, lab, seed=seed, phantom=phantom, load=None)
    start = p.energy().balance
    turned_over = 0.0
    before = p.energy()
    for currents, powered, locked, span_ns in phases:
        p.current_reference[:] = currents
        p.powered[:] = powered
        p.locked[:] = locked
        held = p.motor_angle[p.locked].copy()
        p.advance(p.now_ns + span_ns)
        now = p.energy()
        turned_over += abs(now.input_work - before.input_work) + abs(now.losses - before.losses)
        assert now.losses >= before.losses
        assert now.friction_losses >= before.friction_losses
        assert now.cable_losses >= before.cable_losses
        before = now
        assert np.all(np.isfinite(p.truth))
        assert np.all(p.tension >= 0.0)
        assert p.contact_force >= 0.0
        assert now.kinetic >= 0.0
        assert now.strain >= 0.0
        assert now.phantom >= 0.0
        assert np.max(np.abs(p.current)) <= CONFIG.robot.motor.current_limit
        assert abs(np.linalg.norm(p.quaternion) - 1.0) < 1e-12
        assert np.array_equal(p.motor_angle[p.locked], held)
    assert abs(p.energy().balance - start) <= 0.02 * turned_over + 2e-3


THREE = st.tuples(*[st.floats(-1.0, 1.0)] * 3)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.tuples(*[st.floats(-0.03, 0.03)] * 2) | st.tuples(*[st.floats(-0.4, 0.4)] * 2),
    st.floats(0.0, 0.25),
    THREE,
    THREE.map(lambda v: tuple(3.0 * x / max(1.0, np.linalg.norm(v)) for x in v)),
    THREE,
    st.floats(0.0, 1.0),
)
def test_any_landing(
    place: tuple[float, float],
    above: float,
    tilt: tuple[float, float, float],
    velocity: tuple[float, float, float],
    turning: tuple[float, float, float],
    friction: float,
) -> None:
    """At up to 3 m/s, however tilted and turning: no step gives energy back, accounts close."""
    assert CONFIG.lab is not None
    cradle = CONFIG.lab.cradle.model_copy(update={"friction": friction})
    lab = CONFIG.lab.model_copy(update={"cradle": cradle})
    p = Plant(CONFIG.robot, lab, seed=1, phantom=None, load=None)
    p.place((0.0, 0.0, 1.0), (1.0, *tilt), np.zeros(8))
    half, ends = p.parameters["box_half"][0], p.parameters["box_ends"][0]
    corners = np.array(
        [(x, y, z) for x in (-half[0], half[0]) for y in (-half[1], half[1]) for z in ends]
    )
    lowest = float(np.min(corners @ p.state["rotation"][0, 2]))
    height = float(p.parameters["table_height"][0]) - lowest + above
    p.place((*place, height), (1.0, *tilt), np.zeros(8))
    p.parameters["start_length"] += 10.0
    p.velocity[:] = velocity
    p.angular_velocity[:] = np.multiply(turning, 5.0)
    p.advance(p.now_ns + 1)
    start, last = p.energy().balance, float(p.losses)
    for _ in range(3000):
        p.advance(p.now_ns + CONFIG.lab.plant.substep_us * 1000)
        assert p.losses >= last
        last = float(p.losses)
    assert abs(p.energy().balance - start) < 2e-3 * max(2.0, last)
