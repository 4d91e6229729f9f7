"""The short storm over damaged logs: every reader ends with data or in one line, and touches
nothing. ``make robust`` is the long one."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fuzz.logs import readers
from tests.fuzz.storm_of_logs import storm

pytestmark = pytest.mark.wide

LONG = ("report", "identify", "compare", "figure")
"""judged only a few times here"""


def test_readers_stand_whatever_happened_to_a_log() -> None:
    quick = tuple(name for name in readers(Path()) if name not in LONG)
    ends = storm(3, 15, quick, drawn=1)
    assert {f"{name}: one line" for name in quick} <= set(ends)
    # `info` tells what it found of a damaged log, and ends with 1.
    assert {"recover: done", "export: done", "replay: done"} <= set(ends)


def test_what_draws_and_compares_stands_too() -> None:
    ends = storm(4, 3, LONG, drawn=3)
    # A page of a damaged log is drawn too, and ends with 1.
    assert ends["report: done"] + ends["report: failed"]
