"""The main job on EtherCAT in virtual time: the same bytes for a seed, the same physics as on CAN,
and with the cells on another fieldbus."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from tests.loop import QUICK
from tonus.runtime.states import State
from tonus.tools.expect import Run
from tonus.tools.log import Log
from tonus.tools.testing.player import Player

pytestmark = pytest.mark.tonus(config="config/ethercat.yaml", overrides=QUICK)
ACTIVE = int(State.ACTIVE)


def _run(play: Player, config: str | None = None) -> Run:
    run = play("sine_z", config=config, duration=0.3)
    assert run.state == "STANDBY", run.reason
    assert run.summary["missed_ticks"] == run.summary["missed_by_host"] == 0
    return run


@pytest.fixture(scope="module")
def ethercat(tonus_shared_run: Player) -> Run:
    return _run(tonus_shared_run)


def _figures(log: Log) -> dict[str, float]:
    log.load()
    pose, active = log["/tonus/pose"], log["/tonus/state"]["state"] == ACTIVE
    tension, stiffness = log["/tonus/tension"], log["/tonus/stiffness"]
    error = (pose["desired_position"] - pose["position"])[active]
    return {
        "ticks": float(active.sum()),
        "tracking": float(np.sqrt(np.mean(error**2))),
        "k_eq": float(stiffness["k_eq"][active].mean()),
        "tension": float(tension["measured"][active].mean()),
    }


def _alike(one: Log, other: Log) -> None:
    ours, theirs = _figures(one), _figures(other)
    assert ours["ticks"] == theirs["ticks"]
    assert abs(ours["tracking"] - theirs["tracking"]) < 0.1 * theirs["tracking"] + 2e-5
    assert ours["k_eq"] == pytest.approx(theirs["k_eq"], rel=0.01)
    assert ours["tension"] == pytest.approx(theirs["tension"], rel=0.01)


@pytest.mark.wide
def test_the_same_seed_is_the_same_run_byte_for_byte(ethercat: Run, tonus_run: Player) -> None:
    runs = (ethercat, _run(tonus_run))
    digests = [hashlib.sha256(run.path.read_bytes()).hexdigest() for run in runs]
    assert digests[0] == digests[1]


def test_every_measurement_of_the_run_was_fresh(ethercat: Run) -> None:
    log = ethercat.log
    assert (log["/tonus/drives"]["age"][2:] == 0).all()
    assert (log["/tonus/force_cells"]["age"][2:] == 0).all()
    names = {event.name for event in ethercat.events}
    assert names <= {"state", "stop_mode", "operator", "envelope"}, names


@pytest.mark.long
def test_it_is_the_run_on_can_within_noise(ethercat: Run, tonus_run: Player) -> None:
    _alike(ethercat.log, _run(tonus_run, "config/can.yaml").log)


def test_drives_on_ethercat_and_cells_on_can_are_one_robot(
    ethercat: Run, tonus_run: Player
) -> None:
    _alike(_run(tonus_run, "config/mixed.yaml").log, ethercat.log)
