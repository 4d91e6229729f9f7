"""The plugin's fixtures on a robot with EtherCAT drives."""

from __future__ import annotations

import pytest
from loop import QUICK

from tonus.tools.errors import ToolError
from tonus.tools.testing.held import HeldFactory
from tonus.tools.testing.lab import VirtualLab
from tonus.tools.testing.player import Player

pytestmark = [
    pytest.mark.tonus(config="config/ethercat.yaml", overrides=QUICK),
    pytest.mark.tonus_needs("ethercat"),
    pytest.mark.wide,
]


def test_the_lab_has_time_truth_and_faults_but_no_can_bus(tonus_lab: VirtualLab) -> None:
    for ask in (tonus_lab.bus, tonus_lab.canopen):
        with pytest.raises(ToolError, match="this lab has no CAN bus; use truth, fault"):
            ask("can0")
    tonus_lab.fault("cable_break", channel="tonus0", behind=3)
    tonus_lab.advance(2)
    assert tonus_lab.now == 0.002
    assert [each["fault"]["kind"] for each in tonus_lab.faults] == ["cable_break"]
    assert tonus_lab.truth["tension"].shape == (8,)


@pytest.mark.tonus_expect("*")
def test_a_run_is_judged(tonus_run: Player) -> None:
    fault = {"kind": "cable_cut", "axis": 2, "at": 3.0}
    run = tonus_run("hold", duration=0.3, faults=[fault])
    run.expect("cable_torn", where="axis 2", within=0.02)
    run.invariants()


@pytest.mark.tonus_expect("*")
def test_runs_start_from_a_held_robot(tonus_held: HeldFactory) -> None:
    records = []
    for fault in ("unplug", None, "unplug"):
        held = tonus_held(at="ACTIVE")
        if fault is not None:
            held.fault(fault, channel="tonus0", node=3)
        held.advance(30)
        run = held.end()
        run.replays()
        records.append(held.record.tobytes())
        if fault is not None:
            assert held.state == "SAFE_STOP"
            run.expect("slave_silent", where="tonus0/4", within=0.01)  # and all behind it
            run.expect("drive_lost", where="tonus0/4", within=0.03)
            assert held.reason == "DRIVE_LOST", "silence is no state of a drive"
        else:
            assert held.state == "ACTIVE"
    first, undisturbed, again = records
    assert first == again != undisturbed
