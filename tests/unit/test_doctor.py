"""The doctor: verdicts, cyclictest's histogram, the command, and what a log is given of it."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

from tonus.config import load
from tonus.runtime.timing.histogram import Histogram
from tonus.runtime.timing.realtime import Grant
from tonus.tools.cli.doctor import doctor as command
from tonus.tools.doctor import doctor, lab, privileges, wakeup
from tonus.tools.doctor.finding import Finding, Verdict, graded, worst
from tonus.tools.errors import ToolError
from tonus.tools.run.order import Order, Result

CONFIG = load("config/can.yaml")[0]


@pytest.fixture(autouse=True)
def _cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.mark.parametrize(
    ("value", "good", "bad", "verdict"),
    [
        (50.0, 100.0, 500.0, Verdict.GOOD),
        (100.0, 100.0, 500.0, Verdict.GOOD),
        (101.0, 100.0, 500.0, Verdict.BETTER),
        (501.0, 100.0, 500.0, Verdict.BAD),
        (30.0, 20.0, 4.0, Verdict.GOOD),
        (10.0, 20.0, 4.0, Verdict.BETTER),
        (3.0, 20.0, 4.0, Verdict.BAD),
    ],
)
def test_a_figure_is_graded_by_its_two_limits(
    value: float, good: float, bad: float, verdict: Verdict
) -> None:
    assert graded(value, good, bad) is verdict


def test_the_worst_finding_is_the_verdict() -> None:
    findings = [Finding("a", "", verdict) for verdict in (Verdict.GOOD, Verdict.BAD)]
    assert worst(findings) is Verdict.BAD
    assert worst([]) is Verdict.GOOD


def test_cyclictests_histogram_is_read() -> None:
    text = (
        "# /dev/cpu_dma_latency set to 0us\n# Histogram\n"
        "000000 000000\n000011 000007\n000250 000002\n"
        "# Total: 000000010\n# Max Latencies: 30000\n# Histogram Overflows: 00001\n"
    )
    found = wakeup.parse(text)
    assert found.count == 10
    assert found.at(0.5) == pytest.approx(11_000, rel=1 / 32)
    assert found.at(0.9) == pytest.approx(250_000, rel=1 / 32)
    assert found.largest >= 20_000_000


def test_each_refusal_is_bad_and_has_a_remedy() -> None:
    items = ("SCHED_FIFO 80", "mlockall", "CPU DMA latency 0 us", "processor 1")
    findings = privileges.examine([Grant(item, False, "no") for item in items])
    assert [finding.name for finding in findings] == list(items)
    assert all(finding.verdict is Verdict.BAD and finding.remedy for finding in findings)
    assert len(privileges.examine([Grant(item, True, "") for item in items])) == 1


def test_the_command_measures_and_tells_in_one_json_object(tmp_path: Path) -> None:
    arguments = ["--seconds", "0.1", "--out", str(tmp_path / "out"), "--json"]
    result = CliRunner().invoke(command, arguments)
    found = json.loads(result.stdout)
    assert result.exit_code == (1 if found["verdict"] == "bad" else 0)
    by_name = {entry["name"]: entry for entry in found["findings"]}
    figures = by_name["wake-up"]["figures"]
    assert 0.0 < figures["p50_us"] <= figures["p99_us"] <= figures["max_us"]
    assert by_name["disk"]["figures"]["mib_per_s"] > 0.0
    assert {"stolen time", "kernel preemption", "clock source", "EtherCAT", "rings"} <= set(by_name)
    assert by_name["lab in software"]["figures"]["factor"] > 0.0
    assert not list((tmp_path / "out").iterdir()), "it leaves nothing behind"


@pytest.mark.parametrize(("period_us", "verdict"), [(1000, "bad"), (5000, "could be better")])
def test_the_configured_period_is_judged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, period_us: int, verdict: str
) -> None:
    """600 us late is too much of a millisecond, and little enough of five."""
    asked: list[int] = []

    def late(seconds: float, *, period_ns: int) -> Histogram:
        asked.append(period_ns)
        found = Histogram()
        found.add(600_000)
        return found

    monkeypatch.setattr(wakeup, "bare", late)
    config, _ = load("config/can.yaml", overrides={"control.rates.period_us": period_us})
    findings = {each.name: each for each in doctor.examine(config, tmp_path, 0.1)}
    assert asked == [1000 * period_us]
    assert findings["wake-up"].verdict == verdict
    assert doctor.report(config, list(findings.values()), 0.1)["period_us"] == period_us


@pytest.mark.parametrize(
    ("ticks_a_second", "verdict"),
    [(2900.0, Verdict.GOOD), (2000.0, Verdict.BETTER), (1400.0, Verdict.BAD)],
)
def test_a_host_that_is_too_slow_for_a_lab_is_told(
    monkeypatch: pytest.MonkeyPatch, ticks_a_second: float, verdict: Verdict
) -> None:
    """It may wake up in time and still be."""

    def played(order: Order) -> Result:
        assert order.virtual
        outcome: Any = SimpleNamespace(ticks=6000)
        return Result(outcome, order.out, 6000 / ticks_a_second)

    monkeypatch.setattr(lab, "run", played)
    (found,) = lab.examine(CONFIG)
    assert (found.name, found.verdict) == ("lab in software", verdict)
    assert found.figures["factor"] == pytest.approx(ticks_a_second / 1000.0)
    assert bool(found.remedy) is (verdict is not Verdict.GOOD)


@pytest.mark.parametrize("config", ["config/robot.yaml", "config/direct.yaml"])
def test_no_lab_is_played_for_a_robot_or_without_real_time(config: str) -> None:
    assert lab.examine(load(config)[0]) == []


@pytest.mark.wide
def test_a_report_for_another_period_is_not_taken_up(tmp_path: Path) -> None:
    found = doctor.latest(CONFIG, tmp_path)
    doctor.keep({**found, "seconds": 5.0, "period_us": 2000})
    assert doctor.latest(CONFIG, tmp_path)["seconds"] == doctor.QUICK_S


def test_on_a_robot_a_missing_can_interface_is_bad_and_the_command_is_there(
    tmp_path: Path,
) -> None:
    config, _ = load("config/robot.yaml", overrides={"fieldbus.channels.0.name": "can_none"})
    found = {f.name: f for f in doctor.examine(config, tmp_path, 0.1)}
    missing = found["CAN can_none"]
    assert missing.verdict is Verdict.BAD
    assert missing.remedy.startswith("sudo ip link set can_none up type can bitrate 1000000")


def test_a_folder_that_cannot_be_written_to_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ToolError, match="choose another folder"):
        doctor.examine(CONFIG, tmp_path / "file" / "out", 0.1)


@pytest.mark.wide
def test_a_log_gets_the_last_report_of_this_boot_or_a_quick_one(tmp_path: Path) -> None:
    quick = doctor.latest(CONFIG, tmp_path)
    assert quick["seconds"] == doctor.QUICK_S
    assert doctor.latest(CONFIG, tmp_path)["at_s"] == quick["at_s"], "kept for the next run"
    long = {**quick, "seconds": 5.0, "verdict": "good"}
    doctor.keep(long)
    found = doctor.latest(CONFIG, tmp_path)
    assert found["seconds"] == 5.0
    assert found["age_s"] >= 0.0
    assert doctor.metadata(found)["doctor.verdict"] == "good"
    assert float(doctor.metadata(found)["doctor.wakeup_p99_9_us"]) > 0.0
    doctor.keep({**long, "boot": "another"})
    assert doctor.latest(CONFIG, tmp_path)["seconds"] == doctor.QUICK_S
