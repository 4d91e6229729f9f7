"""A robot that is drawn from the protocol's spread, and sound, raises no alarm."""

from __future__ import annotations

import pytest

from tests.drawn import drawn, play
from tests.loop import QUICK

pytestmark = pytest.mark.wide

SECONDS = 4.0
SHORT, PLANTS = 1, 198
FIRST, BROUGHT_UP, LONG = 1000, 6, 60
"""robots that are brought up in full time: the first seed, how many, and how many in a long test"""


def alarms(scenario: str, seeds: range) -> dict[int, str]:
    """The fault of each seed that ended in one; each draws a plant of its own."""
    config, played = drawn(scenario, QUICK, SECONDS)
    runs = {seed: play(config, played, seed) for seed in seeds}
    return {seed: run.alarm for seed, run in runs.items() if run.alarm}


@pytest.mark.parametrize("scenario", ["sine_x", "contact", "sine_z"])
def test_a_drawn_plant_raises_no_alarm(scenario: str) -> None:
    assert not alarms(scenario, range(SHORT))


@pytest.mark.long
@pytest.mark.parametrize("scenario", ["sine_x", "contact", "sine_z"])
def test_some_two_hundred_drawn_plants_raise_no_alarm(scenario: str) -> None:
    assert not alarms(scenario, range(SHORT, SHORT + PLANTS // 3))


def brought_up(seeds: range) -> dict[int, str]:
    """What was said of each robot that is brought up in full time, or not trusted meanwhile."""
    config, played = drawn("hold", {}, 0.1)
    said = {}
    for seed in seeds:
        run = play(config, played, seed)
        if run.alarm or run.doubted or run.learnt:
            said[seed] = f"{run.alarm} {sorted(run.doubted)} learnt {run.learnt}"
    return said


def test_drawn_robots_are_brought_up_in_full_time_without_a_doubt() -> None:
    assert not brought_up(range(FIRST, FIRST + BROUGHT_UP))


@pytest.mark.long
def test_sixty_drawn_robots_are_brought_up_in_full_time_without_a_doubt() -> None:
    assert not brought_up(range(FIRST + BROUGHT_UP, FIRST + LONG))
