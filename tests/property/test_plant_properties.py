"""Whatever the drives do, the plant stays mechanics: accounts close, nothing pushes on a rope."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from config import load
from config.schema.lab import Backlash, Phantom, Stiffening, Stribeck
from sim.plant import Plant

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
