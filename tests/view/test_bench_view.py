"""`make bench-view`, in a short form: what it prints on a host that computes other things too is no
measurement."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.bench import view_pace, viewers
from tests.loop import QUICK

pytestmark = [pytest.mark.realtime, pytest.mark.wide]
ROOT = Path(__file__).resolve().parents[2]


def test_the_pace_of_pictures_is_measured(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    changes = [f"--set={key}={value}" for key, value in QUICK.items()]
    monkeypatch.setattr(sys, "argv", ["view_pace", "--minutes", "0.03", "--starts", "2", *changes])
    view_pace.main()
    told = capsys.readouterr().out
    assert "2 starts beside daemon and lab: first picture after" in told
    assert "live: first picture after" in told
    assert "log of 0.03 min" in told


@pytest.mark.long
def test_what_viewers_cost_the_ticks_is_measured(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(sys, "argv", ["viewers", "--rounds", "1", "--seconds", "1"])
    viewers.main()
    told = capsys.readouterr().out
    assert "median with 5" in told
