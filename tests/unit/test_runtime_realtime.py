"""Hygiene: granted or refused item by item, given back, and required where it is required."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import pytest

from config import load
from config.schema.realtime import RealTime
from runtime.realtime import Hygiene, RefusedError, demand
from tools.run import Order, run

NO_SUCH_PROCESSOR = 1023


def settings(**changes: object) -> RealTime:
    data = load("config/can.yaml")[0].realtime.model_dump() | {"prefault_mib": 1} | changes
    return RealTime.model_validate(data)


def test_every_item_is_answered_and_given_back() -> None:
    before = (os.sched_getscheduler(0), os.sched_getaffinity(0), gc.isenabled())
    processor = min(os.sched_getaffinity(0))
    hygiene = Hygiene(settings(daemon_cpu=processor))
    items = " ".join(grant.item for grant in hygiene.grants)
    for item in ("heap", "mlockall", "timer slack", "CPU DMA latency", "processor", "SCHED_FIFO"):
        assert item in items
    assert not gc.isenabled()
    assert os.sched_getaffinity(0) == {processor}
    hygiene.release()
    hygiene.release()
    assert (os.sched_getscheduler(0), os.sched_getaffinity(0), gc.isenabled()) == before


def test_a_refusal_is_said_and_the_rest_is_had_under_prefer() -> None:
    hygiene = Hygiene(settings(daemon_cpu=NO_SUCH_PROCESSOR))
    hygiene.release()
    refused = [str(grant) for grant in hygiene.refused if grant.item.startswith("processor")]
    assert len(refused) == 1
    assert "REFUSED" in refused[0]
    assert f"0 to {(os.cpu_count() or 1) - 1}" in refused[0]
    demand(settings(daemon_cpu=NO_SUCH_PROCESSOR))


def test_off_asks_for_nothing_of_the_host() -> None:
    hygiene = Hygiene(settings(policy="off"))
    hygiene.release()
    assert [grant.item for grant in hygiene.grants] == ["collector"]
    assert settings(policy="off").of(70) == 0
    assert settings(policy=False).policy == "off", "YAML reads a bare off as false"


def test_a_run_that_requires_what_is_refused_does_not_begin(tmp_path: Path) -> None:
    over = {"realtime.policy": "require", "realtime.daemon_cpu": NO_SUCH_PROCESSOR}
    config, scenario = load("config/can.yaml", overrides=over)
    log = tmp_path / "run.mcap"
    log.write_bytes(b"an earlier run")
    order = Order(config, scenario, tmp_path, 1, False, lambda _: None, live=False)
    with pytest.raises(RefusedError, match=r"policy is require(.|\n)*processor 1023: REFUSED"):
        run(order)
    assert log.read_bytes() == b"an earlier run"
