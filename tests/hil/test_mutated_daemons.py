"""Daemons without a part of what keeps the robot safe: the supervisor stops each of them alone, as
the table in docs/supervisor_measured.md has it. SUP-1, 3, 4, 5, 6, 7, 9, 10, 25, 26."""

from __future__ import annotations

import pytest

from tests.mutated_daemons import BARE, BRAKED, DAEMONS, played
from tests.supervised import REPORT_MS

pytestmark = pytest.mark.wide


@pytest.mark.parametrize("robot", [BARE, BRAKED])
@pytest.mark.parametrize("name", DAEMONS)
def test_the_supervisor_stops_it_alone(
    name: str, robot: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a robot without brakes and on one that has them."""
    expected, found = DAEMONS[name], played(name, monkeypatch, robot)
    assert found.stopping is expected.stopping
    assert found.requirements == {expected.requirement}, found.error
    assert found.stopped_ms - REPORT_MS <= expected.longest_ms
    assert found.speed <= expected.speed
    speed, broken, seldom = expected.speed_after, expected.broken_after, expected.seldom_after
    if robot == BRAKED:
        speed, broken, seldom = expected.speed_braked, expected.broken_braked, frozenset()
    assert found.speed_after <= speed
    assert found.broken == expected.broken
    assert broken <= found.broken_after <= broken | seldom
