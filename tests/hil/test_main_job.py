"""The main job on the whole lab, every noise and friction on, judged against the plant's truth."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.loop import QUICK
from tests.scripted import scripted
from tonus.config import load
from tonus.config.loader import load_scenario
from tonus.runtime.states import State
from tonus.tools.log import Log
from tonus.tools.run.summary import summarise, truth_at_cycles
from tonus.tools.testing.player import Player

pytestmark = pytest.mark.tonus(overrides=QUICK)

CONTROL = load("config/can.yaml")[0].control
PROFILE = ((3.5, 0.0), (5.5, 100.0), (7.0, 100.0), (7.5, 0.0))
"""s and N: the paper's third stage, at 50 N/s instead of 20 and held for half as long"""


@pytest.fixture(scope="module")
def load_test(tonus_shared_run: Player) -> Log:
    """The paper's third stage over real CAN frames, in less time."""
    script = load_scenario("load_test").lab.model_dump()
    script["load"]["profile"] = [{"at": at, "force": force} for at, force in PROFILE]
    run = tonus_shared_run(scripted("load_test", lab=script), duration=7.0)
    assert run.state == "STANDBY", run.reason
    return run.log


def _active(log: Log) -> np.ndarray:
    return np.asarray(log["/tonus/state"]["state"] == State.ACTIVE)


def test_the_load_is_resisted_inside_every_tension_bound(load_test: Log) -> None:
    log = load_test
    active, tension = _active(log), truth_at_cycles(log, "tension")
    assert tension is not None
    bounds = CONTROL.tension
    assert tension[active].min() > bounds.min
    assert tension[active].max() < bounds.max
    reference = log["/tonus/tension"]["reference"][active]
    assert reference.min() >= bounds.min
    assert reference.max() <= bounds.max
    deficit = log["/tonus/wrench"]["deficit"][active]
    assert deficit.max() < CONTROL.distribution.deficit_limit


def test_the_load_moves_the_platform_as_far_as_its_stiffness_lets_it(
    load_test: Log,
) -> None:
    """100 N over the commanded K_eq: the analytic deflection, to 5 %."""
    log = load_test
    load, position = truth_at_cycles(log, "load"), truth_at_cycles(log, "position")
    assert load is not None
    assert position is not None
    held = _active(log) & (load[:, 0] > 99.9)
    away = (position - log["/tonus/pose"]["desired_position"])[held, 0].mean()
    stiffness = log["/tonus/stiffness"]["k_eq"][held].mean()
    assert away == pytest.approx(100.0 / stiffness, rel=0.05)


def test_the_stiffness_rises_with_the_load_and_returns(load_test: Log) -> None:
    log = load_test
    load = truth_at_cycles(log, "load")
    assert load is not None
    active, k_eq = _active(log), log["/tonus/stiffness"]["k_eq"]
    loaded = active & (load[:, 0] > 99.9)
    released = active & (np.arange(len(active)) > np.flatnonzero(loaded)[-1] + 1500)
    law = CONTROL.stiffness
    expected = law.base * (1.0 + law.force_gain)
    assert k_eq[loaded].mean() == pytest.approx(expected, rel=0.02)
    assert k_eq[released].mean() == pytest.approx(law.base, rel=0.02)
    reference = log["/tonus/tension"]["reference"]
    assert reference[loaded].mean() > reference[released].mean() + 5.0


def test_the_estimated_load_is_the_true_one(load_test: Log) -> None:
    log = load_test
    load = truth_at_cycles(log, "load")
    assert load is not None
    loaded = _active(log) & (load[:, 0] > 99.9)
    estimated = log["/tonus/wrench"]["external"][loaded, 0]
    assert np.median(estimated) == pytest.approx(100.0, abs=1.0)


def test_the_tension_error_in_hold_is_within_half_a_per_cent(
    load_test: Log,
) -> None:
    """The paper's claim for its drives; reference against truth, RMS over all cables."""
    log = load_test
    state = log["/tonus/state"]
    load = truth_at_cycles(log, "load")
    tension = truth_at_cycles(log, "tension")
    assert load is not None
    assert tension is not None
    still = (state["state"] == State.ACTIVE) & (np.abs(load).sum(axis=1) == 0.0)
    still &= np.arange(len(still)) < np.flatnonzero(np.abs(load).sum(axis=1))[0]
    reference = log["/tonus/tension"]["reference"][still]
    error = (tension[still] - reference) / reference
    assert np.sqrt(np.mean(error**2)) <= 0.005


def _contact_peak(play: Player, *, envelope: bool) -> float:
    overrides = {"control.envelope.enabled": envelope}
    run = play("contact", config="config/direct.yaml", overrides=overrides, duration=8.0)
    assert run.state == "STANDBY", run.reason
    force = truth_at_cycles(run.log, "contact_force")
    assert force is not None
    assert ("envelope held" in run.reason) is envelope
    return float(force.max())


@pytest.mark.long
def test_without_the_envelope_the_contact_exceeds_35_n(tonus_run: Player) -> None:
    assert _contact_peak(tonus_run, envelope=False) > 35.0


@pytest.mark.long
@pytest.mark.tonus_expect("envelope")
def test_with_the_envelope_the_contact_stays_within_25_n(tonus_run: Player) -> None:
    assert _contact_peak(tonus_run, envelope=True) <= 25.0


def test_the_summary_keeps_its_contract(load_test: Log) -> None:
    log = load_test
    summary = json.loads(json.dumps(summarise(log, realtime_factor=2.0, steal_percent=0.0)))
    assert set(summary) >= {
        "state",
        "reason",
        "ticks",
        "missed_ticks",
        "realtime_factor",
        "wakeup_us",
        "cycle_us",
        "missed_by_host",
        "steal_percent",
        "tracking_rmse_m",
        "tension_rmse_n",
        "k_eq_n_per_m",
        "tension_n",
        "contact_peak_n",
        "faults",
        "seed",
        "log",
    }
    assert summary["missed_ticks"] == 0
    assert summary["faults"] == []
