"""Faults of the robot itself reach the daemon's inputs alike, with frames and without."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hil.runs import configured, virtual

BUSES = ["config/can.yaml", "config/direct.yaml"]
AT = 2.4
"""s after the drives are enabled; the robot is in ACTIVE by then"""
SLIP, SHIFT, OFFSET = 0.004, 0.003, 4.0
"""rad, m and N: too little for the envelope"""


@pytest.mark.parametrize("path", BUSES)
def test_sensors_that_are_wrong_are_wrong_to_the_daemon(path: str, tmp_path: Path) -> None:
    faults = [
        {"kind": "encoder_slip", "axis": 2, "angle": SLIP, "at": AT},
        {"kind": "cell_offset", "cell": 8, "force": OFFSET, "duration": 0.2, "at": AT},
        {"kind": "cell_gain", "cell": 3, "gain": 1.05, "at": AT},
        {"kind": "tracker_shift", "shift": [0.0, 0.0, SHIFT], "at": AT},
    ]
    config, scenario = configured(path, script={"faults": faults})
    result, log = virtual(config, scenario, tmp_path)
    assert not result.outcome.fault, result.outcome.reason
    truth, cells, tracker = (log[f"/tonus/{name}"] for name in ("truth", "force_cells", "tracker"))
    times = log.times("/tonus/force_cells")
    nearest = np.searchsorted(log.times("/tonus/truth"), times).clip(0, len(truth) - 1)
    true = truth[nearest]
    # The step itself is found in what the daemon was told.
    told = cells["raw"][:, 8] - true["contact_force"]
    begin = int(np.argmax(told > 0.5 * OFFSET + np.median(told)))
    before, after = slice(begin - 150, begin - 20), slice(begin + 20, begin + 150)

    def step(values: object) -> float:
        array = np.asarray(values)
        return float(np.mean(array[after]) - np.mean(array[before]))

    assert step(told) == pytest.approx(OFFSET, abs=0.1)
    assert step(told[200:]) == pytest.approx(-OFFSET, abs=0.1), "it ends after its time"
    angle = log["/tonus/drives"]["angle"] - true["drum_angle"]
    assert step(angle[:, 2]) == pytest.approx(SLIP, abs=6e-4)
    assert step(angle[:, 1]) == pytest.approx(0.0, abs=6e-4)
    tension = true["tension"][:, 3]
    share = step(cells["raw"][:, 3] - tension) / float(np.mean(tension[after]))
    assert share == pytest.approx(0.05, abs=0.005)
    fresh = np.flatnonzero(tracker["fresh"])
    off = tracker["position"][fresh, 2] - true["position"][fresh, 2]
    late = np.mean(off[(fresh > begin + 20) & (fresh < begin + 150)])
    early = np.mean(off[(fresh > begin - 150) & (fresh < begin)])
    assert late - early == pytest.approx(SHIFT, abs=3e-4)


@pytest.mark.parametrize("path", BUSES)
def test_a_cut_cable_pulls_no_more_and_the_log_tells(path: str, tmp_path: Path) -> None:
    faults = [{"kind": "cable_cut", "axis": 5, "at": AT}]
    config, scenario = configured(path, script={"faults": faults})
    _, log = virtual(config, scenario, tmp_path)
    truth = log["/tonus/truth"]
    cut = truth["cut"][:, 5]
    begin = int(np.argmax(cut))
    assert cut[begin:].all()
    assert not np.delete(truth["cut"], 5, axis=1).any()
    assert truth["tension"][begin - 1, 5] > 20.0
    assert not truth["tension"][begin:, 5].any()
    stamp = log.times("/tonus/truth")[begin]
    after = log.times("/tonus/force_cells") > stamp + 10_000_000
    assert np.abs(log["/tonus/force_cells"]["raw"][after, 5]).max() < 2.0
