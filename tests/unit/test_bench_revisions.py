"""`make bench-against`, in a short form: a host that computes other things too measures nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.bench import revisions

ROOT = Path(__file__).resolve().parents[2]


def test_a_revision_that_git_does_not_know_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        revisions.checkout("no-such-revision", ROOT)
    assert ended.value.code == 2
    assert capsys.readouterr().err.startswith("no-such-revision: git knows no such revision")


def test_the_ratio_is_of_pairs_and_here_over_base() -> None:
    row = str(revisions.Compared("a tick", "us", [100.0, 400.0, 200.0], [50.0, 100.0, 150.0]))
    assert row == "| a tick | 200 | 100 | us | 0.50 | 0.25 to 0.75 |"


def test_a_tick_costs_what_the_longer_run_took_more(monkeypatch: pytest.MonkeyPatch) -> None:
    def run(where: Path, config: str, *options: str) -> tuple[float, dict[str, Any]]:
        assert config == "direct"
        seconds = float(options[-1])
        a_tick_s = {"base": 2e-4, "here": 3e-4}[where.name]
        ticks = round(1000 * seconds) + 500  # 500 to stop
        return 3.0 + ticks * a_tick_s, {"ticks": ticks, "realtime_factor": 4.0}

    monkeypatch.setattr(revisions, "_run", run)
    cost, speed = revisions.virtual(Path("base"), Path("here"), "direct", 3, 2.0)
    assert cost.base == pytest.approx([200.0] * 3)
    assert cost.here == pytest.approx([300.0] * 3)
    assert speed.base == speed.here == [4.0] * 3


@pytest.mark.parametrize("minutes", ["0", "-5"])
def test_no_minutes_are_refused_before_anything_is_made(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], minutes: str
) -> None:
    monkeypatch.setattr("sys.argv", ["revisions", "HEAD", "--misses", minutes])
    monkeypatch.setattr(revisions, "checkout", lambda *_: pytest.fail("it has begun"))
    with pytest.raises(SystemExit) as ended:
        revisions.main()
    assert ended.value.code == 2
    told = capsys.readouterr().err.splitlines()[-1]
    assert told.endswith(f"--misses {minutes}: give a number of minutes, 1 or more")


def test_misses_of_both_and_of_a_bare_thread_in_as_many_minutes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The fixed computation becomes as long as a cycle, and each revision is first in turn."""
    order, steps = [], []

    def run(where: Path, config: str, *options: str) -> tuple[float, dict[str, Any]]:
        assert (config, *options) == ("can", "--scenario", "hold", "--duration", "60.0")
        order.append(where.name)
        lost = len(order) == 4
        cycle = {"p50": {"base": 300.0, "here": 200.0}[where.name], "p99_9": 500.0}
        return 0.0, {
            "missed_ticks": len(order),
            "missed_by_host": 10 * len(order),
            "cycle_us": cycle,
            "state": "FAULT" if lost else "STANDBY",
            "reason": "drives lost",
        }

    def fixed(seconds: float, count: int) -> tuple[Any, Any]:
        steps.append(count)
        return np.full(9, 100.0), np.array([900.0, 1100.0, 2500.0])

    monkeypatch.setattr(revisions, "_run", run)
    monkeypatch.setattr(revisions, "fixed_computation", fixed)
    revisions.misses(Path("base"), Path("here"), 2)
    assert order == ["base", "here", "here", "base"]
    assert steps[1] == 2 * steps[0]
    told = capsys.readouterr().out.splitlines()
    assert told[2] == "| 1 | 1 | 2 | 3 | 10 | 20 | 300 / 500 | 200 / 500 | 100 / 100 |"
    assert told[4] == "base: FAULT, drives lost"
    assert told[5] == "| all | 5 | 5 | 6 | 50 | 50 | | | |"


@pytest.mark.wide
def test_a_revision_against_itself(tmp_path: Path) -> None:
    # How long is not asserted: a difference of two short runs is lost in a busy host's noise.
    base = tmp_path / "base"
    base.symlink_to(ROOT)
    cost, speed = revisions.virtual(base, ROOT, "direct", 1, 2.0)
    assert cost.name == "a virtual tick, direct.yaml"
    assert len(cost.here) == len(cost.base) == 1
    assert speed.here[0] > 0.0
    assert speed.base[0] > 0.0
