"""Robots with other numbers of cables than the paper's eight, in whole runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from tests.loop import QUICK
from tests.scripted import scripted
from tonus.config import load
from tonus.runtime.states import State
from tonus.tools.cli.main import tonus
from tonus.tools.expect import Run
from tonus.tools.testing.player import Player

pytestmark = [pytest.mark.tonus(overrides=QUICK), pytest.mark.wide]

DIRECT = {"fieldbus": load("config/direct.yaml")[0].fieldbus.model_dump(mode="json")}
CABLES = {"six": 6, "seven": 7, "twelve": 12}
FORCES = {"six": (0.0, 0.0, -30.0), "seven": (60.0, 0.0, 0.0), "twelve": (60.0, 0.0, 0.0)}
"""N. What hangs from six cables holds more downwards than to a side."""
CUT = {"kind": "cable_cut", "at": 2.5, "axis": 0}


def shortly(name: str) -> list[Any]:
    """The robots, of which `make test-wide` has time for this one."""
    return [each if each == name else pytest.param(each, marks=pytest.mark.long) for each in CABLES]


def same_again(run: Run, cables: int) -> None:
    assert run.log["/tonus/drives"]["angle"].shape[1] == cables
    assert run.log["/tonus/force_cells"]["raw"].shape[1] == cables + 1
    assert run.log["/tonus/truth"]["tension"].shape[1] == cables
    run.replays()


@pytest.mark.parametrize("name", shortly("six"))
@pytest.mark.tonus_expect("wrench_deficit", "pose_cables")
def test_a_load_is_held(name: str, tonus_run: Player) -> None:
    force = float(np.linalg.norm(FORCES[name]))
    profile = [(3.0, 0.0), (4.0, force), (4.5, force), (5.0, 0.0)]
    script = {
        "direction": FORCES[name],
        "point": (0.0, 0.0, 0.0),
        "profile": [{"at": at, "force": pull} for at, pull in profile],
    }
    held = scripted(lab={"load": script})
    run = tonus_run(held, config=f"config/{name}.yaml", overrides=DIRECT, duration=4.0)
    assert run.state == "STANDBY", run.reason
    log = run.log
    active = log["/tonus/state"]["state"] == State.ACTIVE
    away = np.linalg.norm(log["/tonus/truth"]["position"], axis=1)
    assert np.abs(log["/tonus/truth"]["load"]).max() == pytest.approx(force)
    # The law's stiffness bounds how far away the load moves the platform.
    stiffness = load(f"config/{name}.yaml")[0].control.stiffness
    furthest = float(away[: len(active)][active].max())
    assert force / stiffness.maximum < furthest < 1.3 * force / stiffness.base
    tension = log["/tonus/tension"]["reference"][active]
    bounds = load(f"config/{name}.yaml")[0].control.tension
    assert bounds.min <= tension.min() < tension.max() <= bounds.max
    same_again(run, CABLES[name])


@pytest.mark.parametrize("name", shortly("seven"))
@pytest.mark.tonus_expect("wrench_deficit", "envelope")
def test_a_contact_stays_within_its_limit(name: str, tonus_run: Player) -> None:
    # One of the two on frames: what the other bus adds does not depend on the number of cables.
    fieldbus = {} if name == "twelve" else DIRECT
    run = tonus_run("contact_near", config=f"config/{name}.yaml", overrides=fieldbus, duration=4.5)
    assert run.state == "STANDBY", run.reason
    pressed = run.log["/tonus/truth"]["contact_force"].max()
    assert 10.0 < pressed < load(f"config/{name}.yaml")[0].control.envelope.contact_limit
    same_again(run, CABLES[name])
    told = CliRunner().invoke(tonus, ["log", "info", str(run.path)])
    assert told.exit_code == 0, told.output


@pytest.mark.tonus_expect("*")
def test_a_torn_cable_of_twelve_is_found_and_the_platform_comes_down_gently(
    tonus_run: Player,
) -> None:
    run = tonus_run("hold", config="config/twelve.yaml", faults=[CUT], duration=4.0)
    run.expect("cable_torn", where="axis 0", within=0.02)
    truth, state = run.log["/tonus/truth"], run.log["/tonus/state"]
    assert state["fault_where"][-1] == 0
    assert state["failed"][-1].tolist() == [1] + [0] * 11
    speed = np.linalg.norm(truth["velocity"], axis=1)[truth["cut"][:, 0] == 1]
    assert speed.max() < 0.25
    same_again(run, 12)


def test_the_check_says_what_a_suspended_robot_cannot_do() -> None:
    told = CliRunner().invoke(tonus, ["check", "config/six.yaml"])
    assert told.exit_code == 0, told.output
    assert "self-stress   none: gravity is the pretension" in told.output


@pytest.mark.parametrize(("name", "none_left"), [("seven", True), ("direct", False)])
def test_the_check_says_what_a_lost_cable_leaves(name: str, none_left: bool) -> None:
    told = CliRunner().invoke(tonus, ["check", f"config/{name}.yaml"])
    assert told.exit_code == 0, told.output
    assert ("none once a cable is lost" in told.output) is none_left
