"""The main job on EtherCAT in virtual time: the same bytes for a seed, the same physics as on CAN,
and with the cells on another fieldbus."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
from hil.runs import configured, virtual

from tonus.runtime.states import State
from tonus.tools.log import Log

START_NS = 1_000_000_000
"""The runs tick from here, whatever their bring-up takes."""
ACTIVE = int(State.ACTIVE)


def _run(path: str, out: Path, seed: int = 1) -> tuple[Path, Log]:
    config, scenario = configured(path, "sine_z", duration=0.3)
    result, log = virtual(config, scenario, out, seed=seed, start_ns=START_NS)
    assert not result.outcome.fault, result.outcome.reason
    assert result.outcome.misses.own == result.outcome.misses.host == 0
    return result.log, log


@pytest.fixture(scope="module")
def ethercat(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Log]:
    return _run("config/ethercat.yaml", tmp_path_factory.mktemp("ethercat"))


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
def test_the_same_seed_is_the_same_run_byte_for_byte(
    ethercat: tuple[Path, Log], tmp_path: Path
) -> None:
    again, _ = _run("config/ethercat.yaml", tmp_path)
    digests = [hashlib.sha256(path.read_bytes()).hexdigest() for path in (ethercat[0], again)]
    assert digests[0] == digests[1]


def test_every_measurement_of_the_run_was_fresh(ethercat: tuple[Path, Log]) -> None:
    log = ethercat[1]
    assert (log["/tonus/drives"]["age"][2:] == 0).all()
    assert (log["/tonus/force_cells"]["age"][2:] == 0).all()
    names = {event.name for event in log.events()}
    assert names <= {"state", "stop_mode", "operator", "envelope"}, names


@pytest.mark.long
def test_it_is_the_run_on_can_within_noise(ethercat: tuple[Path, Log], tmp_path: Path) -> None:
    _, can = _run("config/can.yaml", tmp_path)
    _alike(ethercat[1], can)


def test_drives_on_ethercat_and_cells_on_can_are_one_robot(
    ethercat: tuple[Path, Log], tmp_path: Path
) -> None:
    _, mixed = _run("config/mixed.yaml", tmp_path)
    _alike(mixed, ethercat[1])
