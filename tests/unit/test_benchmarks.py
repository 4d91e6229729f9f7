"""Every part of `make bench` runs to its end, in a short form: one that nobody ran ended in a
traceback."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import pytest
from loop import QUICK

from tests.bench.__main__ import PARTS
from tests.bench.measure import Figure
from tests.bench.played import started, summary_of

SHORT: dict[str, dict[str, Any]] = {
    "control": {},
    "distribution": {"RECORDED": {"hold": 0.1}, "EACH": 4, "ROUNDS": 1},
    "process_data": {"ROUNDS": 3},
    "frames": {"FRAMES": 200},
    "segment": {"_ROUNDS": 1},
    "ethercat": {"TICKS": 50},
    "whole": {"SECONDS": 0.2, "OVERRIDES": QUICK},
    "log": {"SECONDS": 0.5, "OVERRIDES": QUICK, "CYCLES": 4000, "SAMPLE": 500},
    "realtime": {"_SHORT_S": 1.0, "_SHORT_ROUNDS": 1},
}
"""what each part has less of here"""
MARKS = {
    "ethercat": [pytest.mark.realtime],
    "realtime": [pytest.mark.realtime, pytest.mark.long],
    "distribution": [pytest.mark.long],
    "whole": [pytest.mark.long],
    "log": [pytest.mark.long],
}
"""The first two start processes of their own; the long ones play whole runs, as other tests do."""


def once(action: Callable[[], object], number: int, repeat: int) -> list[float]:
    """In the place of `timeit.repeat`."""
    action()
    return [1e-6 * number] * repeat


@pytest.mark.parametrize(
    "part",
    [pytest.param(part, marks=MARKS.get(part.__name__, [])) for part in PARTS],
    ids=lambda part: part.__name__,
)
def test_a_part_runs_to_its_end(
    part: Callable[[], list[Figure]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.bench.measure.timeit.repeat", once)
    for step in ("active_step", "loaded_step"):  # tests/unit/test_short_forms.py has them
        monkeypatch.setattr(f"tests.bench.control.{step}", lambda: 1.0)
    for key, value in SHORT[part.__name__].items():
        monkeypatch.setattr(sys.modules[part.__module__], key, value)
    figures = part()
    # Where the host allows no veth pair there is no round trip to be measured.
    assert figures or part.__name__ == "ethercat"
    assert all(each.value >= 0.0 for each in figures)


def test_a_cold_cache_stops_no_benchmark() -> None:
    """It ended with `no run`: what is compiled is told between the lines of the summary."""
    code = (
        "import sys\n"
        "print('{', flush=True)\n"
        "print('compiling: tonus.runtime', file=sys.stderr, flush=True)\n"
        "print('\"ticks\": 7}')"
    )
    assert summary_of(started([sys.executable, "-c", code], {}), 60.0) == {"ticks": 7}


def test_a_benchmark_without_a_run_ends_with_the_daemons_reason() -> None:
    daemon = started([sys.executable, "-c", "raise SystemExit('the host refuses')"], {})
    with pytest.raises(RuntimeError, match="no run: the host refuses"):
        summary_of(daemon, 60.0)
