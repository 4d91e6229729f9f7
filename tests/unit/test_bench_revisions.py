"""`make bench-against`, in a short form: a host that computes other things too measures nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

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
