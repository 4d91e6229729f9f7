"""Faults of the robot itself reach the daemon's inputs alike, with frames and without."""

from __future__ import annotations

import numpy as np
import pytest
from loop import QUICK

import tonus
from tonus.tools.testing.held import HeldFactory

pytestmark = [pytest.mark.tonus(overrides=QUICK), pytest.mark.tonus_expect("*")]
BUSES = [pytest.param("config/can.yaml", marks=pytest.mark.long), "config/direct.yaml"]
SLIP, SHIFT, OFFSET = 0.004, 0.003, 4.0
"""rad, m and N: too little for the envelope"""


@pytest.mark.parametrize("path", BUSES)
def test_sensors_that_are_wrong_are_wrong_to_the_daemon(path: str, tonus_held: HeldFactory) -> None:
    faults = [
        tonus.faults.EncoderSlip(axis=2, angle=SLIP),
        tonus.faults.CellOffset(cell=8, force=OFFSET, duration=0.2),
        tonus.faults.CellGain(cell=3, gain=1.05),
        tonus.faults.ShiftedTracker(shift=(0.0, 0.0, SHIFT)),
    ]
    robot = tonus_held(config=path, at="ACTIVE")
    robot.advance(200)
    for fault in faults:
        robot.fault(fault)
    robot.advance(400)
    assert robot.state == "ACTIVE", robot.reason
    log = robot.end().log
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
def test_a_cut_cable_pulls_no_more_and_the_log_tells(path: str, tonus_held: HeldFactory) -> None:
    robot = tonus_held(config=path, at="ACTIVE")
    robot.advance(20)
    robot.fault("cable_cut", axis=5)
    robot.advance(100)
    log = robot.end().log
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
