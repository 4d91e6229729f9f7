"""What once broke a bound, played again."""

from __future__ import annotations

from pathlib import Path

import pytest

from tonus.config.loader import load_study
from tonus.tools.campaign import regression
from tonus.tools.campaign.invariants import within_bounds
from tonus.tools.campaign.play import play

STUDY = load_study("faults")
KEPT = sorted(Path(__file__).with_name("regressions").glob(f"*{regression.SUFFIX}"))


@pytest.mark.parametrize("path", KEPT, ids=lambda path: path.name.removesuffix(regression.SUFFIX))
def test_a_mended_violation_stays_mended(path: Path) -> None:
    episode = regression.load(path).episode
    seen = play(episode, tail=STUDY.times.tail, longest=STUDY.times.longest, named=STUDY.named)
    assert within_bounds(seen, replayed=True) == []
