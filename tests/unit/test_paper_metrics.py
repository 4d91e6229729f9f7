"""Indicators of made-up trials whose answers are known in closed form."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from paper_setup import BASE, CONFIG, TENSION, sine, steps, still

from tonus.config import load
from tonus.config.schema.lab import LabScript
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.signals import Grade
from tonus.tools.paper import indicators as formula
from tonus.tools.paper.case import Kind
from tonus.tools.paper.forces import cable_wrench
from tonus.tools.paper.metrics import measure, traces

CONFIGS = Path(__file__).parents[2] / "config"


def test_a_perfect_trial_has_no_error_and_breaks_nothing() -> None:
    found = measure(still(Kind.HOLD))
    assert found["position_rmse"] == found["tension_rmse"] == found["effort"] == 0.0
    assert found["slack_ticks"] == found["violation_ticks"] == found["tension_low_ticks"] == 0
    assert found["k_eq_mean"] == BASE
    assert "settling" not in found
    assert "contact_speed" not in found


def test_every_indicator_is_a_finite_number_of_python() -> None:
    for kind in Kind:
        for value in measure(still(kind)).values():
            assert type(value) is float
            assert math.isfinite(value)


def test_tracking_is_judged_against_the_truth_over_whole_periods_after_the_fade() -> None:
    trial = still(Kind.SINE, sine(0.01, 1.0), 6.3)
    phase = 2.0 * np.pi * trial.time
    trial.truth["position"][:, 0] += 0.001 * np.sin(phase)
    trial.truth["position"][trial.time < 2.0] += 1.0
    trial.truth["position"][trial.time >= 6.0] += 1.0
    found = measure(trial)
    assert found["position_rmse"] == pytest.approx(0.001 / math.sqrt(2.0), rel=1e-9)
    assert found["periods"] == 4


@pytest.mark.parametrize("lag", [4.5, -30.0, 100.0])
def test_phase_and_amplitude_of_a_platform_that_trails(lag: float) -> None:
    trial = still(Kind.SINE, sine(0.03, 0.75), 8.0)
    angle = 2.0 * np.pi * 0.75 * trial.time - math.radians(lag)
    trial.truth["position"][:, 2] = 0.95 * 0.03 * np.sin(angle) + 0.002
    found = measure(trial)
    assert found["phase_lag_deg"] == pytest.approx(lag, abs=1e-6)
    assert found["amplitude_error_percent"] == pytest.approx(-5.0, abs=1e-6)


def second_order(time: np.ndarray, omega: float, zeta: float) -> np.ndarray:
    """Unit step response, from the textbook."""
    damped = omega * math.sqrt(1.0 - zeta**2)
    wave = np.cos(damped * time) + zeta * omega / damped * np.sin(damped * time)
    return np.where(time < 0.0, 0.0, 1.0 - np.exp(-zeta * omega * np.maximum(time, 0.0)) * wave)


@pytest.mark.parametrize("zeta", [0.3, 0.5])
def test_overshoot_and_settling_of_a_second_order_step(zeta: float) -> None:
    omega, offset = 20.0, np.array([0.0, 0.0002, 0.0])
    trial = still(Kind.MOVE, steps(0.01), 4.0)
    up, down = second_order(trial.time, omega, zeta), second_order(trial.time - 2.0, omega, zeta)
    trial.truth["position"][:] = offset
    trial.truth["position"][:, 0] = 0.01 * (up - down)
    found = measure(trial)
    peak = 100.0 * math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2))
    assert found["overshoot_percent"] == pytest.approx(peak, rel=2e-3)
    outside = np.flatnonzero(np.abs(up[:2000] - 1.0) > 0.02)[-1]
    assert found["settling"] == pytest.approx(trial.time[outside + 1], abs=1.5e-3)
    assert found["steady_error"] == pytest.approx(0.0002, abs=1e-6)


def test_a_step_that_never_settles_has_no_settling_time() -> None:
    trial = still(Kind.MOVE, steps(0.01), 4.0)
    trial.truth["position"][:, 0] += 0.001 * np.sin(40.0 * trial.time)
    found = measure(trial)
    assert found["unsettled"] == 2
    assert "settling" not in found


def loaded(kind: Kind, shape: np.ndarray, deviation: np.ndarray) -> dict[str, float]:
    trial = still(kind, duration=(len(shape) - 1) * 1e-3)
    trial.truth["load"][:, 1] = shape
    trial.truth["position"][:, 1] += deviation
    trial.cycle["stiffness.k_eq"] = BASE * (1.0 + 0.18 * deviation / deviation.max())
    return measure(trial)


def test_a_load_step_with_exponential_yielding() -> None:
    time, tau = np.arange(5001) * 1e-3, 0.05
    on = (time > 1.0) & (time <= 4.0)
    shape = np.where(on, 25.0, 0.0)
    deviation = np.where(time > 1.0, 0.007 * (1.0 - np.exp(-np.maximum(time - 1.0, 0) / tau)), 0.0)
    found = loaded(Kind.STEP, shape, deviation)
    assert found["load_deviation_peak"] == pytest.approx(0.007, rel=1e-6)
    assert found["load_deviation_end"] == pytest.approx(0.007, rel=1e-6)
    assert found["reaction"] == pytest.approx(-tau * math.log(1.0 - 0.63), abs=1e-4)
    assert found["load_settling"] == pytest.approx(-tau * math.log(0.02), abs=2e-3)


def test_a_ramp_settles_from_its_end_and_has_no_reaction_time() -> None:
    time = np.arange(9001) * 1e-3
    shape = np.clip(20.0 * (time - 1.0), 0.0, 100.0)
    shape[time > 8.5] = 0.0
    deviation = np.clip(0.006 * (time - 1.0), 0.0, 0.03)
    deviation += np.where(time > 6.0, 0.002 * np.exp(-(time - 6.0) / 0.1), 0.0)
    found = loaded(Kind.RAMP, shape, deviation)
    expected = 0.1 * math.log(0.002 / (0.02 * 0.032))
    assert found["load_settling"] == pytest.approx(expected, abs=8e-3)
    assert found["load_peak"] == 100.0
    assert "reaction" not in found


def test_a_constant_stiffness_has_no_reaction_time() -> None:
    trial = still(Kind.STEP)
    trial.truth["load"][1000:3000, 0] = 25.0
    assert "reaction" not in measure(trial)


def test_losses_and_efficiency_of_known_powers() -> None:
    trial = still(Kind.SINE, sine(0.01, 1.0), 6.0)
    trial.truth["friction_losses"] = 100.0 + 1.5 * trial.time
    trial.truth["cable_losses"] = 0.5 * trial.time
    trial.truth["copper_losses"] = 3.0 * trial.time
    swing = np.sin(2.0 * np.pi * trial.time)
    trial.truth["platform_power"] = 2.0 * swing
    trial.truth["electrical_power"] = np.where(swing > 0.0, 5.0 * swing, -100.0)
    found = measure(trial)
    assert found["energy_dissipated"] == pytest.approx(5.0 * 4.0, rel=1e-3)
    assert found["energy_per_period"] == pytest.approx(5.0, rel=1e-3)
    assert found["efficiency_percent"] == pytest.approx(40.0, rel=1e-3)


def test_one_drive_that_winds_in_against_its_own_resistance() -> None:
    trial = still(Kind.HOLD)
    current, rate = 2.0, 3.0
    trial.truth["current"][:, 3], trial.truth["drum_rate"][:, 3] = current, rate
    motor, drum, lab = CONFIG.robot.motor, CONFIG.robot.drum, CONFIG.lab
    assert lab is not None
    shaft = motor.torque_constant * CONFIG.robot.gearbox.ratio * current * rate
    spent = shaft + lab.plant.winding_resistance * current**2
    gained = TENSION * drum.radius * rate
    assert measure(trial)["drive_efficiency_percent"] == pytest.approx(100.0 * gained / spent)


def test_tension_errors_in_newtons_and_per_cent() -> None:
    trial = still(Kind.HOLD)
    trial.truth["tension"][:, ::2] += 0.9
    found = measure(trial)
    assert found["tension_rmse"] == pytest.approx(0.9 / math.sqrt(2.0))
    assert found["tension_percent"] == pytest.approx(2.0 / math.sqrt(2.0))


def test_slack_and_violations_are_counted_in_ticks() -> None:
    trial = still(Kind.CONTACT)
    trial.truth["tension"][100:103, 2] = 4.0
    trial.truth["contact_force"][200] = 26.0
    trial.truth["tension"][300:400, 5] = 20.0
    trial.truth["velocity"][500:502, 0] = 0.3
    trial.cycle["envelope.grade"][:400] = Grade.AMBER
    found = measure(trial)
    assert found["slack_ticks"] == 3
    assert found["violation_ticks"] == 6
    assert found["amber_percent"] == pytest.approx(100.0 * 400 / 4001)
    assert found["violation_longest"] == 3
    assert found["tension_low_ticks"] == 103
    assert "contact_peak" not in found


def test_a_contact_has_a_peak_where_there_is_something_to_touch() -> None:
    trial = still(Kind.CONTACT)
    script = LabScript(
        phantom=load(str(CONFIGS / "direct.yaml"), scenario="contact")[1].lab.phantom
    )
    trial.run = replace(
        trial.run,
        case=replace(
            trial.run.case,
            scenario=trial.run.case.scenario.model_copy(update={"lab": script}),
        ),
    )
    trial.truth["contact_force"][1500] = 26.0
    trial.truth["velocity"][1400:1600, 0] = 0.1
    found = measure(trial)
    assert found["contact_peak"] == 26.0
    assert found["contact_speed"] == pytest.approx(0.1)


def test_a_press_is_judged_by_the_true_force_on_the_body() -> None:
    press = {
        "kind": "press",
        "direction": [1.0, 0.0, 0.0],
        "distance": 0.0,
        "approach": 0.5,
        "fade": 0.5,
        "force": 12.0,
        "swing": 4.0,
        "frequency": 0.5,
        "stiffness": 210.0,
    }
    trial = still(Kind.PRESS, press, 5.0)
    since = trial.time - 0.5
    trial.truth["contact_force"] = 12.0 + 4.0 * np.sin(np.pi * since) + 0.3
    found = measure(trial)
    assert found["contact_force_rmse"] == pytest.approx(0.3, rel=1e-9)
    trial.truth["contact_force"] = 12.0 + 4.0 * np.sin(np.pi * since - math.radians(10.0))
    assert measure(trial)["force_phase_lag_deg"] == pytest.approx(10.0, abs=1e-6)


def test_the_slope_of_force_against_way() -> None:
    trial = still(Kind.SLOPE, duration=10.0)
    way = 0.03 * (1.0 - np.abs(trial.time / 5.0 - 1.0))
    trial.truth["position"][:, 2] = -way
    trial.truth["velocity"][:, 2] = np.gradient(-way, 1e-3)
    friction = 0.5 * np.sign(np.gradient(way))
    trial.truth["load"][:, 2] = -(420.0 * way + friction + 3.0)
    trial.truth["contact_force"] = 210.0 * way
    found = measure(trial)
    assert found["slope_loading"] == pytest.approx(420.0, rel=1e-6)
    assert found["slope_unloading"] == pytest.approx(420.0, rel=1e-6)
    assert found["slope"] == pytest.approx(420.0, rel=1e-3)
    assert found["slope_phantom"] == pytest.approx(210.0, rel=1e-6)
    assert found["travel"] == pytest.approx(0.03, rel=1e-3)


def test_forces_agree_with_the_controllers_kinematics() -> None:
    rng = np.random.default_rng(5)
    position = rng.uniform(-0.1, 0.1, (20, 3))
    turn = rng.normal(0.0, 0.1, (20, 4)) + np.array([1.0, 0.0, 0.0, 0.0])
    turn /= np.linalg.norm(turn, axis=1)[:, None]
    tension = rng.uniform(20.0, 100.0, (20, 8))
    found = cable_wrench(CONFIG.robot.geometry, position, turn, tension)
    kinematics = Kinematics(CONFIG.robot.geometry)
    for row in range(20):
        kinematics.evaluate(position[row], turn[row])
        assert found[row] == pytest.approx(kinematics.matrix @ tension[row], abs=1e-9)


def test_r_squared_of_the_mean_is_nothing_and_of_less_is_negative() -> None:
    measured = np.array([1.0, 2.0, 3.0, 4.0])
    assert formula.r_squared(measured, measured) == 1.0
    assert formula.r_squared(measured, np.full(4, 2.5)) == 0.0
    assert formula.r_squared(measured, measured[::-1]) == pytest.approx(-3.0)
    assert formula.r_squared(np.ones(4), measured) is None


def test_a_band_holds_its_own_sine_and_not_its_neighbour() -> None:
    time = np.arange(10_000) * 1e-3
    values = 3.0 * np.sin(2.0 * np.pi * 5.0 * time) + 2.0 * np.sin(2.0 * np.pi * 40.0 * time)
    inside = formula.band_rms(time, values, 0.0, 10.0)
    assert inside == pytest.approx(3.0 / math.sqrt(2.0), rel=1e-3)


@pytest.mark.parametrize(
    ("flags", "longest"), [([], 0), ([0, 0], 0), ([1, 1, 0, 1], 2), ([0, 1, 1, 1], 3)]
)
def test_the_longest_run(flags: list[int], longest: int) -> None:
    assert formula.longest_run(np.array(flags, dtype=bool)) == longest


def test_traces_keep_the_picture_at_equal_steps() -> None:
    trial = still(Kind.SINE, sine(0.03, 0.5), 20.0)
    curves = traces(trial)
    lengths = {len(values) for values in curves.values()}
    assert len(lengths) == 1
    assert lengths.pop() <= 3000
    assert np.ptp(np.diff(curves["time"].astype(float))) < 1e-5
    assert float(curves["position"][:, 2].max()) == pytest.approx(0.03, rel=1e-3)
