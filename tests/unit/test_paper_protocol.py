"""The paper's stages as cases, the robots they are played on, and one trial of each sort."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from loop import QUICK

from tonus.config import Config, load
from tonus.config.loader import load_protocol
from tonus.config.schema.lab import LabScript
from tonus.config.schema.scenario import Sine
from tonus.runtime.states import State
from tonus.sim.plant import Plant
from tonus.tools.errors import ToolError
from tonus.tools.paper.case import Kind, Run
from tonus.tools.paper.conduct import SLOW_TICKS, conduct
from tonus.tools.paper.plants import refuse, settle
from tonus.tools.paper.protocol import Programme, plant_runs, robot_seconds, runs
from tonus.tools.paper.trial import Trial

PROTOCOL = load_protocol()
CONFIG, _ = load("config/direct.yaml")
BRISK, _ = load("config/direct.yaml", overrides=QUICK)
ALL = frozenset({1, 2, 3})


def named(name: str, config: Config = BRISK) -> Any:
    return next(case for case in Programme(PROTOCOL, config).cases() if case.name == name)


def short(name: str, duration: float) -> Any:
    case = named(name)
    return replace(case, scenario=case.scenario.model_copy(update={"duration": duration}))


def carried(run: Run) -> Trial:
    return conduct(run, settle(PROTOCOL, BRISK, run))


# --- the programme -------------------------------------------------------------------------------


def test_stage_two_has_every_sine_of_the_paper() -> None:
    wanted = {(a, f) for a in (0.010, 0.020, 0.030) for f in (0.25, 0.5, 1.0)}
    wanted |= {(0.005, f) for f in (0.5, 1.0, 2.0)}
    for direction in ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)):
        found = [
            case.scenario
            for case in Programme(PROTOCOL, CONFIG).cases()
            if isinstance(case.scenario.reference, Sine)
            and case.scenario.reference.direction == direction
        ]
        assert {(s.reference.amplitude, s.reference.frequency) for s in found} == wanted
        for scenario in found:
            periods = (scenario.duration - scenario.reference.fade) * scenario.reference.frequency
            assert periods >= 3.0


def test_every_trial_has_a_key_of_its_own_and_the_whole_stays_under_six_hours() -> None:
    full = runs(PROTOCOL, CONFIG, PROTOCOL.full, ALL)
    keys = {run.key for run in full}
    assert len(keys) == len(full)
    assert not any(set(key) & set("/\\ :*") for key in keys)
    assert sum(robot_seconds(CONFIG, run) for run in full) < 6 * 3600.0
    assert sum(run.plant.startswith("plant-") for run in full) >= 200
    assert {run.controller for run in full if run.case.name == "contact"} == set(
        PROTOCOL.full.controllers
    )


def test_quick_is_a_part_of_the_full_protocol() -> None:
    quick = runs(PROTOCOL, CONFIG, PROTOCOL.quick, ALL)
    full = {run.key for run in runs(PROTOCOL, CONFIG, PROTOCOL.full, ALL)}
    assert {run.key for run in quick} <= full
    assert sum(robot_seconds(CONFIG, run) for run in quick) < 1500.0


def test_stages_are_chosen() -> None:
    assert {run.case.stage for run in runs(PROTOCOL, CONFIG, PROTOCOL.full, frozenset({2}))} == {2}


def test_a_case_that_is_none_is_named() -> None:
    selection = PROTOCOL.quick.model_copy(update={"cases": ("sine_q",)})
    with pytest.raises(ToolError, match="sine_q"):
        runs(PROTOCOL, CONFIG, selection, ALL)


# --- robots --------------------------------------------------------------------------------------


def test_the_model_has_no_noise_and_the_lab_differs_from_it() -> None:
    case = named("step_x")
    model = settle(PROTOCOL, CONFIG, Run(case, "pd", "model", 1, "direct"))
    lab = settle(PROTOCOL, CONFIG, Run(case, "pd", "lab", 1, "direct"))
    assert model.lab is not None
    assert lab.lab is not None
    noise = model.lab.noise
    assert (noise.force_cell.sigma, noise.tracker.position_sigma, noise.tracker.jitter_ms) == (
        0.0,
        0.0,
        0.0,
    )
    assert lab.lab.noise.force_cell.sigma > 0.0
    assert lab.lab.plant.anchor_sigma > model.lab.plant.anchor_sigma == 0.0
    assert model.control.controller == "pd"
    assert CONFIG.control.controller == "bio"


def test_drawn_plants_differ_from_each_other() -> None:
    first, second = (
        Plant(BRISK.robot, settled.lab, seed=run.seed, phantom=None, load=None).parameters
        for run in plant_runs(PROTOCOL, BRISK, 2)
        if (settled := settle(PROTOCOL, BRISK, run)).lab is not None
    )
    for name in ("mass", "axial_stiffness", "anchors", "coulomb"):
        assert not np.allclose(first[name], second[name])


def test_what_a_campaign_cannot_run_on_is_said() -> None:
    with pytest.raises(ToolError, match="direct"):
        refuse(load("config/can.yaml")[0], "config/can.yaml")


def test_a_script_cannot_play_a_load_and_a_displacement() -> None:
    load_ = {"direction": (1, 0, 0), "point": (0, 0, 0), "profile": [{"at": 0, "force": 0}] * 2}
    lead = {"direction": (1, 0, 0), "stiffness": 1.0, "damping": 0.0}
    profile = [{"at": 0.0, "distance": 0.0}, {"at": 1.0, "distance": 0.1}]
    with pytest.raises(ValueError, match="not both"):
        LabScript.model_validate({"load": load_, "displacement": lead | {"profile": profile}})
    with pytest.raises(ValueError, match="begin with distance 0"):
        LabScript.model_validate({"displacement": lead | {"profile": profile[1:] * 2}})


# --- trials --------------------------------------------------------------------------------------


def test_a_step_of_load_comes_when_it_should_and_the_truth_lies_beside_the_record() -> None:
    trial = carried(Run(short("step_x", 1.2), "pd", "lab", 1, "direct"))
    assert trial.fault == ""
    assert trial.time[0] == 0.0
    assert len(trial.time) == pytest.approx(1200, abs=3)
    assert set(trial.cycle["state.state"].tolist()) == {int(State.ACTIVE)}
    assert {len(column) for column in (*trial.cycle.values(), *trial.truth.values())} == {
        len(trial.time)
    }
    force = trial.truth["load"][:, 0]
    onset = trial.time[np.argmax(force > 0.0)]
    assert onset == pytest.approx(PROTOCOL.lead, abs=0.02)
    assert force[-1] == PROTOCOL.jump.force
    # A tick of shift between the two would show as speed times a millisecond.
    off = trial.cycle["pose.position"] - trial.truth["position"]
    assert np.linalg.norm(off, axis=1).max() < 1.5e-3
    moved = trial.truth["position"][-1, 0] - trial.truth["position"][0, 0]
    assert moved == pytest.approx(25.0 / trial.config.control.pd.stiffness, rel=0.2)


def test_a_fault_ends_a_trial_and_says_why() -> None:
    trial = carried(Run(named("eq9_literal"), "eq9_literal", "lab", 1, "direct"))
    assert trial.fault == "drum_torque"
    assert trial.state == "FAULT"
    assert trial.reason
    assert trial.time[-1] < 2.0


# --- stage 1 -------------------------------------------------------------------------------------


def test_the_constant_tension_slope_is_geometric_stiffness_and_phantom() -> None:
    """Against a difference quotient of the plant's own wrench, with the tensions the run had."""
    slope = PROTOCOL.slope.model_copy(update={"speed": 0.005, "distance": 0.006, "wait": 1.2})
    protocol = PROTOCOL.model_copy(update={"slope": slope})
    run = Run(Programme(protocol, BRISK).slope(1), "constant_tension", "model", 1, "direct")
    assert run.case.kind is Kind.SLOPE
    config = settle(protocol, BRISK, run)
    trial = conduct(run, config)
    assert len(trial.time) == pytest.approx(3700 / SLOW_TICKS, abs=2)
    z, force = trial.truth["position"][:, 2], trial.truth["load"][:, 2]
    led = (force != 0.0) & (np.abs(trial.truth["velocity"][:, 2]) > 0.004)
    assert np.ptp(z[led]) == pytest.approx(0.006, rel=0.15)
    measured = np.polyfit(z[led], force[led], 1)[0]
    tensions = trial.truth["tension"][led].mean(axis=0)
    assert np.ptp(trial.truth["tension"][led], axis=0).max() < 1.0

    assert config.lab is not None
    still = Plant(
        config.robot, config.lab, seed=1, phantom=run.case.scenario.lab.phantom, load=None
    )
    level, step = (1.0, 0.0, 0.0, 0.0), 1e-3
    up, down = (still.wrench((0.0, 0.0, 0.003 + s), level, tensions)[2] for s in (step, -step))
    expected = (down - up) / (2.0 * step)
    assert expected == pytest.approx(423.0, rel=0.01)
    assert measured == pytest.approx(expected, rel=0.03)
