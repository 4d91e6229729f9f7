"""Robots drawn from the protocol's spread: sound, and not as configured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.loop import ClosedLoop
from tonus.config import load
from tonus.config.loader import load_protocol
from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.runtime.operation.operator import Script
from tonus.runtime.signals import Consistency
from tonus.runtime.states import Fault, State

_ARMED = (State.PRETENSION, State.HOLD, State.ACTIVE)


@dataclass(frozen=True)
class Played:
    """How a run of a drawn robot went."""

    alarm: str
    """fault and place, or a wrong last state; empty when sound"""
    doubted: frozenset[Consistency]
    """what was named while armed"""
    learnt: int
    """how often refused tracker poses were followed"""


def drawn(
    scenario: str, overrides: Mapping[str, Any], seconds: float | None = None
) -> tuple[Config, Scenario]:
    """A configuration whose seeds draw robots from the protocol's spread, and a scenario of at most
    so many ``seconds``."""
    spread = load_protocol().drawn
    config, played = load("config/direct.yaml", scenario=scenario, overrides=dict(overrides))
    data = config.model_dump()
    data["lab"]["plant"].update(spread.plant)
    data["lab"]["noise"]["force_cell"].update(spread.force_cell)
    data["lab"]["noise"]["tracker"].update(spread.tracker)
    if seconds is not None:
        played = played.model_copy(update={"duration": min(played.duration, seconds)})
    return Config.model_validate(data), played


def play(config: Config, scenario: Scenario, seed: int, *, until: State | None = None) -> Played:
    """The whole scenario on the robot of a seed, or up to the first tick in a state."""
    loop, script = ClosedLoop(config, scenario, seed=seed), Script(scenario.duration)
    sequence = loop.cycle.sequence
    while not script.finished and sequence.state is not until:
        loop.tick(script.next(sequence))
    last = State.STANDBY if until is None else until
    sound = sequence.fault is Fault.NONE and loop.state is last
    alarm = "" if sound else f"{sequence.fault.name} {sequence.where} in {loop.state.name}"
    cycle = loop.trace.cycle
    armed = np.isin(cycle["state"]["state"], _ARMED)
    named = {Consistency(value) for value in cycle["pose"]["consistency"][armed].tolist()}
    learnt = int(cycle["tracker"]["learnt"].max())
    return Played(alarm, frozenset(named - {Consistency.GOOD}), learnt)
