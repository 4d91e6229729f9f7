"""A robot that is drawn from the protocol's spread, and sound, raises no alarm."""

from __future__ import annotations

import pytest

from tests.loop import QUICK, ClosedLoop
from tonus.config import load
from tonus.config.loader import load_protocol
from tonus.config.schema.root import Config
from tonus.runtime.operation.operator import Script
from tonus.runtime.states import Fault, State

pytestmark = pytest.mark.wide

SECONDS = 4.0
SHORT, PLANTS = 1, 198


def alarms(scenario: str, seeds: range) -> dict[int, str]:
    """The fault of each seed that ended in one; each draws a plant of its own."""
    protocol = load_protocol()
    config, played = load("config/direct.yaml", scenario=scenario, overrides=QUICK)
    data = config.model_dump()
    data["lab"]["plant"].update(protocol.drawn.plant)
    data["lab"]["noise"]["force_cell"].update(protocol.drawn.force_cell)
    data["lab"]["noise"]["tracker"].update(protocol.drawn.tracker)
    drawn = Config.model_validate(data)
    played = played.model_copy(update={"duration": min(played.duration, SECONDS)})
    found = {}
    for seed in seeds:
        loop, script = ClosedLoop(drawn, played, seed=seed), Script(played.duration)
        while not script.finished:
            loop.tick(script.next(loop.cycle.sequence))
        sequence = loop.cycle.sequence
        if sequence.fault is not Fault.NONE or loop.state is not State.STANDBY:
            found[seed] = f"{sequence.fault.name} {sequence.where}"
    return found


@pytest.mark.parametrize("scenario", ["sine_x", "contact", "sine_z"])
def test_a_drawn_plant_raises_no_alarm(scenario: str) -> None:
    assert not alarms(scenario, range(SHORT))


@pytest.mark.long
@pytest.mark.parametrize("scenario", ["sine_x", "contact", "sine_z"])
def test_some_two_hundred_drawn_plants_raise_no_alarm(scenario: str) -> None:
    assert not alarms(scenario, range(SHORT, SHORT + PLANTS // 3))
