"""Frequency response: M, C and K of made-up oscillators, and their intervals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import TransferFunction, lsim
from scipy.spatial.transform import Rotation

from tonus.config import load
from tonus.runtime.states import State
from tonus.tools.identify.record import Record
from tonus.tools.identify.response import Response, loop_response, response_between
from tonus.tools.log import Log

Array = NDArray[np.float64]
CONFIG, _ = load("config/direct.yaml")
MASS, DAMPING, STIFFNESS = 2.35, 139.0, 3210.0
TIME = np.arange(20_000) * 1e-3
MANY = (0.2, 0.4, 0.6, 0.8, 1.0, 1.4, 1.8, 2.2)


def record(position: Array) -> Record:
    """ACTIVE throughout, cables taut, the platform at ``position`` (n, 3)."""
    rows = len(position)
    even = np.full((rows, 8), 45.0)
    return Record(
        path=Path("made-up.mcap"),
        log=cast(Log, None),
        config=CONFIG,
        period=1e-3,
        time=TIME[:rows],
        state=np.full(rows, State.ACTIVE, dtype=np.uint8),
        angle=np.zeros((rows, 8)),
        torque=np.zeros((rows, 8)),
        tension=even,
        desired=np.zeros((rows, 3)),
        stiffness=np.full(rows, STIFFNESS),
        good=np.ones(rows, dtype=bool),
        ticks=np.arange(rows),
        exposure=TIME[:rows:8],
        seen_position=position[::8],
        seen_rotation=Rotation.identity(len(TIME[:rows:8])),
    )


def pushed(frequencies: tuple[float, ...], seed: int, *, mismatch: float = 0.0) -> Response | None:
    """The response of an oscillator that sines of 5 N push along a slanting line; the force told is
    off by a share of ``mismatch``, another at each frequency and always the same there."""
    random = np.random.default_rng(seed)
    phases = random.uniform(0.0, 2.0 * np.pi, len(frequencies))
    sines = np.array(
        [np.sin(2.0 * np.pi * f * TIME + p) for f, p in zip(frequencies, phases, strict=True)]
    )
    force = 5.0 * sines.sum(axis=0)
    shares = 1.0 + mismatch * random.standard_normal(len(frequencies))
    system = TransferFunction([1.0], [MASS, DAMPING, STIFFNESS])
    _, displacement, _ = lsim(system, force, TIME)
    way = np.array([0.6, 0.0, 0.8])
    position = np.outer(displacement, way) + 2e-5 * random.standard_normal((len(TIME), 3))
    told = np.outer(5.0 * shares @ sines, way) + 0.5 * random.standard_normal((len(TIME), 3))
    return response_between("loop", [(record(position), told, position)])


@pytest.mark.parametrize("mismatch", [0.0, 0.02])
def test_mass_damping_and_stiffness_lie_in_their_intervals(mismatch: float) -> None:
    true = np.array([MASS, DAMPING, STIFFNESS])
    found = [pushed(MANY, seed, mismatch=mismatch) for seed in range(10)]
    responses = [response for response in found if response is not None]
    assert len(responses) == 10
    held = [np.abs(r.fit.value - true) <= r.fit.half_width for r in responses]
    assert (np.mean(held, axis=0) >= 0.8).all()
    assert np.median([r.fit.half_width[2] for r in responses]) < 0.04 * STIFFNESS


def test_the_lines_lie_on_the_oscillator_at_the_frequencies_of_the_push() -> None:
    response = pushed(MANY, 1)
    assert response is not None
    strong = [line for line in response.lines if line.half_width < 0.03]
    for f in MANY:
        assert min(abs(line.frequency - f) for line in strong) < 0.02
    for line in strong:
        assert min(abs(line.frequency - f) for f in MANY) < 0.02
        s = 2j * np.pi * line.frequency
        true = 1.0 / (MASS * s**2 + DAMPING * s + STIFFNESS)
        assert abs(line.compliance / true - 1.0) < 0.05


def test_one_frequency_alone_cannot_tell_mass_from_stiffness() -> None:
    assert pushed((0.6,), 1) is None


@pytest.mark.parametrize("rows", [100, 400, 2000])
def test_a_record_that_is_too_short_has_no_response(rows: int) -> None:
    position = np.zeros((rows, 3))
    position[:, 0] = 0.01 * np.sin(6.0 * TIME[:rows])
    assert response_between("platform", [(record(position), position, position)]) is None


def test_a_load_is_what_the_mass_and_the_cables_leave_over() -> None:
    """The cables of a controller with K and D only; the mass is the platform's own."""
    push = 5.0 * np.sum([np.sin(2.0 * np.pi * f * TIME + f * f) for f in MANY], axis=0)
    system = TransferFunction([1.0], [MASS, DAMPING, STIFFNESS])
    _, along, _ = lsim(system, push, TIME)
    position = np.outer(along, [1.0, 0.0, 0.0])
    velocity = np.gradient(position, 1e-3, axis=0)
    loaded = record(position)
    loaded.__dict__["force"] = -STIFFNESS * position - DAMPING * velocity
    response = loop_response([loaded], MASS)
    assert response is not None
    np.testing.assert_allclose(response.fit.value, [MASS, DAMPING, STIFFNESS], rtol=0.01)


def test_silent_devices_and_slack_cables_are_left_out() -> None:
    whole = record(np.zeros((2000, 3)))
    good, tension = whole.good.copy(), whole.tension.copy()
    good[100] = False
    tension[1000:, 3] = 1.0
    part = replace(whole, good=good, tension=tension)
    chosen = part.during(State.ACTIVE)
    assert not chosen[100]
    assert chosen[101:900].all()
    assert not chosen[1100:].any()
    assert not part.during(State.HOLD).any()
