"""A run that is stopped while its load pulls: the load ends with it, in the lab of this process and
in one of its own; a fault's stop has to cope with the load."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from runs import configured, virtual

pytestmark = pytest.mark.wide

_PULLS_ON = {
    "load": {
        "direction": [1.0, 0.0, 0.0],
        "point": [0.0, 0.0, 0.0],
        "profile": [{"at": 3.0, "force": 0.0}, {"at": 5.0, "force": 60.0}],
    }
}


def test_the_load_ends_with_the_run(tmp_path: Path) -> None:
    config, scenario = configured("config/direct.yaml", duration=2.0, script=_PULLS_ON)
    result, log = virtual(config, scenario, tmp_path)
    assert result.outcome.fault == 0, result.outcome.reason
    force = np.linalg.norm(log["/tonus/truth"]["load"][:, :3], axis=1)
    assert force.max() > 30.0
    assert force[-1] == 0.0
    # As fast as the configuration states: no jump, and over before the platform is lowered far.
    falls = -np.diff(force).min() / 1e-3
    assert config.lab is not None
    assert falls == pytest.approx(config.lab.load_release, rel=0.02)


def test_after_a_fault_the_load_pulls_on(tmp_path: Path) -> None:
    torn = {"kind": "cable_cut", "axis": 2, "at": 5.0}
    script = _PULLS_ON | {"faults": [torn]}
    config, scenario = configured("config/direct.yaml", duration=4.0, script=script)
    result, log = virtual(config, scenario, tmp_path)
    assert result.outcome.fault != 0
    force = np.linalg.norm(log["/tonus/truth"]["load"][:, :3], axis=1)
    assert force[-1] == force.max() == pytest.approx(60.0)
