"""Daemons without a part of what keeps the robot safe: the supervisor stops each of them alone, as
the table in docs/supervisor.md has it. SUP-1, 3, 4, 5, 6, 7, 9, 10, 25, 26."""

from __future__ import annotations

import pytest

from tests.mutated_daemons import DAEMONS, played

pytestmark = pytest.mark.wide


@pytest.mark.parametrize("name", DAEMONS)
def test_the_supervisor_stops_it_alone(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    expected, found = DAEMONS[name], played(name, monkeypatch)
    assert found.stopping is expected.stopping
    assert found.requirements == {expected.requirement}, found.error
    assert found.stopped_ms <= expected.longest_ms
    assert found.speed <= expected.speed
    assert found.speed_after <= expected.speed_after
    assert (found.broken, found.broken_after) == (expected.broken, expected.broken_after)
