"""`make bench-against`, in a short form: a host that computes other things too measures nothing."""

from __future__ import annotations

from pathlib import Path

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


@pytest.mark.wide
def test_a_revision_against_itself(tmp_path: Path) -> None:
    base = tmp_path / "base"
    base.symlink_to(ROOT)
    cost, speed = revisions.virtual(base, ROOT, "direct", 1, 2.0)
    assert cost.name == "a virtual tick, direct.yaml"
    assert 0.2 < cost.here[0] / cost.base[0] < 5.0
    assert 0.2 < speed.here[0] / speed.base[0] < 5.0
