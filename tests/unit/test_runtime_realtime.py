"""Hygiene: granted or refused item by item, given back, and required where it is required."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from tonus.config import load
from tonus.config.schema.realtime import RealTime
from tonus.runtime.timing import kernel_workers, realtime
from tonus.runtime.timing.awake import Choice, Comparison, compare
from tonus.runtime.timing.realtime import Hygiene, RefusedError, compared, demand, prepare, settled
from tonus.tools.run.composer import Order, run

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


def test_only_the_daemons_processor_is_kept_awake_where_it_has_one() -> None:
    quiet = settled(settings(daemon_cpu="quietest")).daemon_cpu
    file = Path(f"/sys/devices/system/cpu/cpu{quiet}/power/pm_qos_resume_latency_us")
    hygiene = Hygiene(settings(daemon_cpu="quietest", cpu_dma_latency_us=0))
    told = next(str(grant) for grant in hygiene.grants if "DMA" in grant.item)
    pinned = os.sched_getaffinity(0)
    awake = file.read_text().strip() if file.exists() else ""
    hygiene.release()
    assert pinned == {quiet}
    if os.access(file, os.W_OK):
        assert "on the daemon's processor" in told
        assert awake == "n/a"
        assert file.read_text().strip() == "0"
    else:
        assert "on every processor" in told or "REFUSED" in told
    everywhere = Hygiene(settings(daemon_cpu=None, cpu_dma_latency_us=0))
    everywhere.release()
    told = next(str(grant) for grant in everywhere.grants if "DMA" in grant.item)
    assert "every processor" in told or "REFUSED" in told


def test_all_are_kept_awake_where_others_answer_late_otherwise() -> None:
    held: list[str] = []
    usable = os.sched_getaffinity(0)
    processor = max(usable)

    def hold(choice: Choice) -> Callable[[], object]:
        held.append(choice)
        return lambda: held.append("free")

    found = compare(processor, processor, hold)
    assert held == ["own", "free", "all", "free"] * 3
    assert found.own_us > 0.0
    assert found.all_us > 0.0
    assert os.sched_getaffinity(0) == usable
    assert Comparison(own_us=1500.0, all_us=90.0).better == "all"
    assert Comparison(own_us=60.0, all_us=20.0).better == "own", "soon enough as it is"
    assert Comparison(own_us=90.0, all_us=400.0).better == "own", "the host stops all of it"
    assert Comparison(own_us=1500.0, all_us=1200.0).better == "own", "no great help"


def test_it_is_measured_only_where_it_matters() -> None:
    for changes in (
        {"awake": "own"},
        {"awake": "all"},
        {"policy": "off"},
        {"cpu_dma_latency_us": None},
        {"daemon_cpu": None},
        {"daemon_cpu": NO_SUCH_PROCESSOR},
    ):
        assert compared(settled(settings(**{"awake": "measured", **changes}))) is None
    hygiene = Hygiene(settings(awake="all", cpu_dma_latency_us=0))
    hygiene.release()
    told = next(str(grant) for grant in hygiene.grants if "DMA" in grant.item)
    assert "every processor" in told or "REFUSED" in told


def test_what_a_killed_daemon_left_awake_may_sleep_after_the_next_one() -> None:
    last = max(os.sched_getaffinity(0))
    file = Path(f"/sys/devices/system/cpu/cpu{last}/power/pm_qos_resume_latency_us")
    if not os.access(file, os.W_OK):
        pytest.skip("this host does not let us say which processor stays awake")
    file.write_text("n/a")
    Hygiene(settings(daemon_cpu=last, cpu_dma_latency_us=0)).release()
    assert file.read_text().strip() == "0"


def test_kernel_workers_are_kept_off_the_daemons_processor_while_it_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mask = tmp_path / "cpumask"
    monkeypatch.setattr(kernel_workers, "MASK", mask)
    last = max(os.sched_getaffinity(0))
    for before, without in (
        (1 << last | 1 << 40, "00000100,00000000"),
        ((1 << last) + (1 << last + 1), f"{1 << last + 1:08x}"),
    ):
        mask.write_text(f"{before:x}\n")
        hygiene = Hygiene(settings(daemon_cpu=last, kernel_workers="others"))
        held = mask.read_text()
        hygiene.release()
        assert held == without
        assert int(mask.read_text(), 16) == before
    for asked in (
        {"daemon_cpu": None, "kernel_workers": "others"},
        {"daemon_cpu": last, "kernel_workers": None},
        {"daemon_cpu": last, "kernel_workers": "others", "policy": "off"},
    ):
        mask.write_text(f"{before:x}")
        hygiene = Hygiene(settings(**asked))
        assert mask.read_text() == f"{before:x}"
        assert not [grant for grant in hygiene.grants if grant.item == "kernel workers"]
        hygiene.release()


def test_kernel_workers_that_are_kept_off_already_stay_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mask = tmp_path / "cpumask"
    monkeypatch.setattr(kernel_workers, "MASK", mask)
    last = max(os.sched_getaffinity(0))
    mask.write_text(f"{1 << last + 1:x}\n")
    hygiene = Hygiene(settings(daemon_cpu=last, kernel_workers="others"))
    hygiene.release()
    assert mask.read_text() == f"{1 << last + 1:x}\n"
    assert not hygiene.refused
    mask.unlink()
    hygiene = Hygiene(settings(daemon_cpu=last, kernel_workers="others"))
    hygiene.release()
    assert any("kernel workers: REFUSED" in str(grant) for grant in hygiene.refused)


def test_processes_beside_the_daemon_keep_off_its_processor() -> None:
    usable = os.sched_getaffinity(0)
    try:
        prepare(priority=0, processors="others", lock_memory=False)
        beside = os.sched_getaffinity(0)
    finally:
        os.sched_setaffinity(0, usable)
    found = settled(settings(daemon_cpu="quietest", lab_cpu="others", recorder_cpu=0))
    assert beside == set(found.lab_cpu) == (usable - {found.daemon_cpu} or usable)
    assert found.recorder_cpu == 0
    assert settings(policy="off").on("others") is None


def test_the_quietest_processor_has_served_the_fewest_interrupts_of_devices(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = tmp_path / "interrupts"
    monkeypatch.setattr(realtime, "_INTERRUPTS", table)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2, 3})
    table.write_text(
        "           CPU0       CPU1       CPU2       CPU3\n"
        " 36:          0          3          7          1  PCI-MSIX 1-edge  virtio1-req.0\n"
        " 38:          9          0          0          2  PCI-MSIX 1-edge  virtio2-input.0\n"
        "LOC:          0     999999          0          0  Local timer interrupts\n"
        "ERR:          0\n"
    )
    assert settled(settings(daemon_cpu="quietest", lab_cpu="others")).daemon_cpu == 3
    assert settled(settings(daemon_cpu="quietest", lab_cpu="others")).lab_cpu == (0, 1, 2)
    assert settled(settings(daemon_cpu=None, lab_cpu="others")).lab_cpu == "others"
    table.unlink()
    assert settled(settings(daemon_cpu="quietest")).daemon_cpu == 3


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
