"""When a test in real time is tried again: as tests/conftest.py says."""

from __future__ import annotations

from pathlib import Path

import pytest

from tonus.runtime.timing import realtime

pytest_plugins = ["pytester"]

MODULE = """
import pytest
from itertools import count

numbers = count()

@pytest.mark.{mark}
def test_it(): assert next(numbers) in {good}
"""
INI = """
[pytest]
markers =
    realtime:
    long:
"""


@pytest.mark.parametrize(
    ("mark", "good", "stolen", "outcome"),
    [
        ("realtime", {0}, 1, {"passed": 1}),
        ("realtime", {1}, 1, {"passed": 1, "rerun": 1}),
        ("realtime", {2}, 1, {"passed": 1, "rerun": 2}),
        ("realtime", {3}, 1, {"failed": 1, "rerun": 2}),
        ("realtime", {1}, 0, {"failed": 1}),
        ("long", {1}, 1, {"failed": 1}),
    ],
)
def test_only_what_the_host_disturbed_is_tried_again(
    pytester: pytest.Pytester,
    monkeypatch: pytest.MonkeyPatch,
    mark: str,
    good: set[int],
    stolen: int,
    outcome: dict[str, int],
) -> None:
    clock = iter(range(0, 1000, stolen)) if stolen else iter([0] * 1000)
    monkeypatch.setattr(realtime, "stolen_jiffies", lambda: (next(clock), 1000))
    pytester.makeini(INI)
    pytester.makeconftest((Path(__file__).parents[1] / "conftest.py").read_text())
    pytester.makepyfile(MODULE.format(mark=mark, good=good))
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider")
    assert result.parseoutcomes() == outcome
