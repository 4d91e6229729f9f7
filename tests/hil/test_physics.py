"""What the robot achieves in the plant with all noise and friction on, measured against truth."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from loop import QUICK, ClosedLoop, Trace, configured, contact_of, rms
from scipy.spatial.transform import Rotation

from tonus.config.schema.scenario import Scenario
from tonus.runtime.states import State

CONFIG, _ = configured("hold")
TENSION, LAW = CONFIG.control.tension, CONFIG.control.stiffness
LIMIT = CONFIG.control.envelope.contact_limit


@cache
def run(scenario: str, duration: float | None = None, *, envelope: bool = True) -> Trace:
    """A scenario from switch-on to rest; shared by the tests that look at it."""
    overrides: dict[str, Any] = QUICK | {"control.envelope.enabled": envelope}
    config, script = configured(scenario, overrides)
    if duration is not None:
        script = script.model_copy(update={"duration": duration})
    return ClosedLoop(config, script).complete()


def active(trace: Trace, after: float = 0.0) -> Trace:
    return trace.during(State.ACTIVE, after=after)


def ended_well(trace: Trace) -> bool:
    return bool(trace.state[-1] == State.STANDBY and trace.cycle["state"]["fault"][-1] == 0)


@pytest.mark.parametrize(
    "axis",
    [
        pytest.param("x", marks=pytest.mark.wide),
        pytest.param("y", marks=pytest.mark.long),
        "z",
    ],
)
def test_a_sine_of_30_mm_is_followed_within_a_quarter_of_a_millimetre(axis: str) -> None:
    trace = run(f"sine_{axis}", 6.0)
    part = active(trace)
    wanted, true = part.cycle["pose"]["desired_position"], part.truth["position"]
    assert np.ptp(true[:, "xyz".index(axis)]) > 0.058, "it moved"
    assert rms(np.linalg.norm(true - wanted, axis=1)) <= 0.25e-3
    assert rms(part.cycle["tension"]["reference"] - part.truth["tension"]) <= 0.25
    assert ended_well(trace)


@pytest.mark.wide
@pytest.mark.parametrize(
    "name",
    ["tilt", *(pytest.param(each, marks=pytest.mark.long) for each in ("circle", "table"))],
)
def test_a_path_in_space_is_followed_as_well_as_a_sine(name: str) -> None:
    """A circle in a tilted plane, and two that tilt the platform by up to 4 degrees."""
    trace = run(name, 4.0)
    part = active(trace)
    pose, true = part.cycle["pose"], part.truth
    assert rms(np.linalg.norm(true["position"] - pose["desired_position"], axis=1)) <= 0.25e-3
    wanted, turned = (
        Rotation.from_quat(np.roll(each, -1, axis=1))  # w last
        for each in (pose["desired_quaternion"], true["quaternion"])
    )
    assert (wanted.magnitude().max() > 0.03) == (name != "circle")
    assert rms((turned * wanted.inv()).magnitude()) <= 1e-3
    assert ended_well(trace)


def test_the_estimate_is_where_the_platform_is_while_it_moves() -> None:
    part = active(run("sine_x", 6.0))
    assert rms(part.cycle["pose"]["position"] - part.truth["position"]) < 5.0e-5
    assert rms(part.cycle["pose"]["velocity"] - part.truth["velocity"]) < 5.0e-3


def test_tension_in_hold_is_within_half_a_per_cent_of_pretension() -> None:
    part = active(run("hold", 3.0), after=0.5)
    error = part.cycle["tension"]["reference"] - part.truth["tension"]
    assert rms(error) <= 0.005 * TENSION.pre


STEP = Scenario.model_validate(
    {
        "name": "step",
        "description": "20 mm in half a second, then 25 N at once",
        "duration": 3.5,
        "reference": {
            "kind": "path",
            "waypoints": [{"position": [0.02, 0.0, 0.0], "duration": 0.5, "pause": 3.0}],
        },
        "lab": {
            "load": {
                "direction": [0.0, 1.0, 0.0],
                "point": [0.0, 0.0, 0.0],
                "profile": [{"at": 4.4, "force": 0.0}, {"at": 4.401, "force": 25.0}],
            }
        },
    }
)


@cache
def stepped() -> Trace:
    config, _ = configured("hold", QUICK)
    loop = ClosedLoop(config, STEP)
    loop.until(State.ACTIVE)
    loop.run(STEP.duration)
    return active(loop.trace)


def test_a_step_settles_in_0_8_s_and_hardly_overshoots() -> None:
    """2 % of the step, counted from its start; the paper has 1.36 s and 2.9 %."""
    part = stepped()
    quiet = part.truth["load"][:, 1] == 0.0
    share = part.truth["position"][quiet, 0] / 0.02
    time = part.cycle["state"]["elapsed"][quiet]
    assert time[-1] > 1.0
    assert time[np.abs(share - 1.0) > 0.02][-1] <= 0.8
    assert share.max() <= 1.029


def test_the_stiffness_answers_a_load_within_100_ms() -> None:
    """63 % of its rise, from the force's onset."""
    part = stepped()
    stiffness, onset = part.cycle["stiffness"]["k_eq"], int(np.argmax(part.truth["load"][:, 1] > 0))
    before, after = stiffness[onset - 100 : onset].mean(), stiffness[-300:].mean()
    assert after - before > 400.0
    reached = np.flatnonzero(stiffness[onset:] >= before + 0.63 * (after - before))[0]
    assert reached < 100


@pytest.mark.long
def test_without_the_envelope_contact_exceeds_35_n() -> None:
    assert contact_of(run("contact", 7.5, envelope=False)).max() > 35.0


@pytest.mark.wide
def test_contact_that_would_exceed_35_n_stays_within_the_limit() -> None:
    with_it = run("contact", 7.5)
    assert 10.0 < contact_of(with_it).max() <= LIMIT
    assert ended_well(with_it)


def test_the_stiffness_gives_way_to_contact() -> None:
    part = active(run("contact", 7.5))
    pressed = contact_of(part) > 0.95 * contact_of(part).max()
    assert np.median(part.cycle["stiffness"]["k_eq"][pressed]) < 0.5 * LAW.base
    assert part.cycle["envelope"]["progress"].min() < 0.1
    assert part.truth["tension"].min() > TENSION.slack


def test_pressed_near_the_limit_the_stiffness_does_not_chatter() -> None:
    """It comes down and stays: its ups and downs together are less than twice the way down (1.05 to
    1.61 times, seeds 1 to 5). Without hysteresis they were fifteen times as much."""
    part = active(run("contact", 7.5))
    pressed = part.cycle["stiffness"]["k_eq"][contact_of(part) > 15.0]
    assert np.abs(np.diff(pressed)).sum() < 2.0 * np.ptp(pressed)


def test_another_seed_is_another_run_and_the_same_seed_the_same() -> None:
    config, script = configured("hold", QUICK)
    traces = []
    for seed in (1, 1, 2):
        loop = ClosedLoop(config, script, seed=seed)
        loop.until(State.PRETENSION)
        traces.append(loop.trace)
    first, same, other = (trace.cycle.tobytes() for trace in traces)
    assert first == same
    assert first != other
