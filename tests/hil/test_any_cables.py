"""Robots with other numbers of cables than the paper's eight, in whole runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from hil.runs import configured, virtual

from tonus.config import load
from tonus.runtime.states import Fault, State
from tonus.tools.cli.main import tonus
from tonus.tools.log import Log
from tonus.tools.log.replay import replay
from tonus.tools.run.composer import Result

pytestmark = pytest.mark.wide

DIRECT = {"fieldbus": load("config/direct.yaml")[0].fieldbus.model_dump(mode="json")}
CABLES = {"six": 6, "seven": 7, "twelve": 12}
FORCES = {"six": (0.0, 0.0, -30.0), "seven": (60.0, 0.0, 0.0), "twelve": (60.0, 0.0, 0.0)}
"""N. What hangs from six cables holds more downwards than to a side."""
CUT = {"kind": "cable_cut", "at": 2.5, "axis": 0}


def run(
    name: str, scenario: str, out: Path, *, bus: bool = False, **options: Any
) -> tuple[Result, Log]:
    config, played = configured(
        f"config/{name}.yaml", scenario, overrides={} if bus else DIRECT, **options
    )
    return virtual(config, played, out)


def shortly(name: str) -> list[Any]:
    """The robots, of which `make test-wide` has time for this one."""
    return [each if each == name else pytest.param(each, marks=pytest.mark.long) for each in CABLES]


def same_again(log: Log, cables: int) -> None:
    assert log["/tonus/drives"]["angle"].shape[1] == cables
    assert log["/tonus/force_cells"]["raw"].shape[1] == cables + 1
    assert log["/tonus/truth"]["tension"].shape[1] == cables
    again = replay(log)
    assert again.first is None
    assert again.ticks == len(log["/tonus/timing"])


@pytest.mark.parametrize("name", shortly("six"))
def test_a_load_is_held(name: str, tmp_path: Path) -> None:
    force = float(np.linalg.norm(FORCES[name]))
    profile = [(3.0, 0.0), (4.0, force), (4.5, force), (5.0, 0.0)]
    script = {
        "direction": FORCES[name],
        "point": (0.0, 0.0, 0.0),
        "profile": [{"at": at, "force": pull} for at, pull in profile],
    }
    result, log = run(name, "hold", tmp_path, duration=4.0, script={"load": script})
    assert result.outcome.state is State.STANDBY, result.outcome.reason
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
    same_again(log, CABLES[name])


@pytest.mark.parametrize("name", shortly("seven"))
def test_a_contact_stays_within_its_limit(name: str, tmp_path: Path) -> None:
    # One of the two on frames: what the other bus adds does not depend on the number of cables.
    result, log = run(name, "contact_near", tmp_path, bus=name == "twelve", duration=4.5)
    assert result.outcome.state is State.STANDBY, result.outcome.reason
    pressed = log["/tonus/truth"]["contact_force"].max()
    assert 10.0 < pressed < load(f"config/{name}.yaml")[0].control.envelope.contact_limit
    same_again(log, CABLES[name])
    told = CliRunner().invoke(tonus, ["log", "info", str(result.log)])
    assert told.exit_code == 0, told.output


def test_a_torn_cable_of_twelve_is_found_and_the_platform_comes_down_gently(tmp_path: Path) -> None:
    result, log = run("twelve", "hold", tmp_path, bus=True, duration=4.0, script={"faults": [CUT]})
    assert result.outcome.fault is Fault.CABLE_TORN
    truth, state = log["/tonus/truth"], log["/tonus/state"]
    assert state["fault_where"][-1] == 0
    assert state["failed"][-1].tolist() == [1] + [0] * 11
    speed = np.linalg.norm(truth["velocity"], axis=1)[truth["cut"][:, 0] == 1]
    assert speed.max() < 0.25
    same_again(log, 12)


def test_the_check_says_what_a_suspended_robot_cannot_do() -> None:
    told = CliRunner().invoke(tonus, ["check", "config/six.yaml"])
    assert told.exit_code == 0, told.output
    assert "self-stress   none: gravity is the pretension" in told.output
