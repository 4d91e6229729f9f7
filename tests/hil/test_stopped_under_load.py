"""A run that is stopped while its load pulls: the load ends with it, in the lab of this process and
in one of its own; a fault's stop has to cope with the load."""

from __future__ import annotations

import numpy as np
import pytest

from tests.loop import QUICK
from tests.scripted import scripted
from tonus.config import load
from tonus.tools.testing.player import Player

pytestmark = [
    pytest.mark.tonus(config="config/direct.yaml", overrides=QUICK),
    pytest.mark.wide,
]

_PULLS_ON = {
    "load": {
        "direction": [1.0, 0.0, 0.0],
        "point": [0.0, 0.0, 0.0],
        "profile": [{"at": 3.0, "force": 0.0}, {"at": 5.0, "force": 60.0}],
    }
}


def test_the_load_ends_with_the_run(tonus_run: Player) -> None:
    run = tonus_run(scripted(lab=_PULLS_ON), duration=2.0)
    assert run.state == "STANDBY", run.reason
    force = np.linalg.norm(run.log["/tonus/truth"]["load"][:, :3], axis=1)
    assert force.max() > 30.0
    assert force[-1] == 0.0
    # As fast as the configuration states: no jump, and over before the platform is lowered far.
    falls = -np.diff(force).min() / 1e-3
    lab = load("config/direct.yaml")[0].lab
    assert lab is not None
    assert falls == pytest.approx(lab.load_release, rel=0.02)


@pytest.mark.tonus_expect("*")
def test_after_a_fault_the_load_pulls_on(tonus_run: Player) -> None:
    torn = {"kind": "cable_cut", "axis": 2, "at": 5.0}
    run = tonus_run(scripted(lab=_PULLS_ON), faults=[torn], duration=4.0)
    assert run.state == "FAULT"
    force = np.linalg.norm(run.log["/tonus/truth"]["load"][:, :3], axis=1)
    assert force[-1] == force.max() == pytest.approx(60.0)
