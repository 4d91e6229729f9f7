"""A violation reduced: fewer faults and commands, round numbers, a nominal robot; still broken."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from tonus.config.schema.campaign import Study
from tonus.config.schema.scenario import Scenario
from tonus.tools.campaign.campaign import played
from tonus.tools.campaign.draw import begins, undisturbed
from tonus.tools.campaign.episode import Episode, Setup
from tonus.tools.campaign.judge import Row

_NEVER_ROUNDED = ("kind", "channel", "node", "axis", "cell", "code", "input")
_CONTROLLER = "control.controller"
_ROUNDS = 12
Violates = Callable[[Sequence[Episode]], list[bool]]


def minimise(study: Study, episode: Episode, invariant: str, workers: int) -> Episode:
    """The simplest episode found that still breaks ``invariant``."""

    def violates(candidates: Sequence[Episode]) -> list[bool]:
        numbered = [each.model_copy(update={"index": n}) for n, each in enumerate(candidates, 1)]
        rows = {row["index"]: row for row in played(study, numbered, workers)}
        return [breaks(rows[each.index], invariant) for each in numbered]

    return reduced(study, episode, violates)


def breaks(row: Row, invariant: str) -> bool:
    """Whether an episode broke a certain bound."""
    return any(each["invariant"] == invariant for each in row["violations"])


def reduced(study: Study, episode: Episode, violates: Violates) -> Episode:
    """Take the first simpler episode of a round that still violates, until none does."""
    for _ in range(_ROUNDS):
        candidates = list(simpler(study, episode))
        if not candidates:
            break
        found = violates(candidates)
        if not any(found):
            break
        episode = candidates[found.index(True)]
    return episode


def simpler(study: Study, episode: Episode) -> Iterator[Episode]:
    """Episodes with something left out or rounded, the boldest first."""
    scenario, setup = episode.scenario, episode.setup
    faults = scenario.lab.faults
    if len(faults) > 1:
        for kept in faults:
            yield _with(study, setup, _faulted(scenario, (kept,)))
    if len(faults) > 2:
        for left in faults:
            yield _with(study, setup, _faulted(scenario, tuple(f for f in faults if f is not left)))
    spreads = study.plants.overrides
    if any(key in setup.overrides for key in spreads):
        plain = {key: value for key, value in setup.overrides.items() if key not in spreads}
        yield _with(study, setup.model_copy(update={"overrides": plain}), scenario)
    first = study.controllers[0]
    if setup.overrides.get(_CONTROLLER) != first:
        changed = setup.overrides | {_CONTROLLER: first}
        yield _with(study, setup.model_copy(update={"overrides": changed}), scenario)
    for command in scenario.operator[:-1]:
        left_over = tuple(each for each in scenario.operator if each is not command)
        if command.command != "start":
            yield _with(study, setup, scenario.model_copy(update={"operator": left_over}))
    for digits in (1, 2):
        rounded = _rounded(scenario, digits)
        if rounded != scenario:
            yield _with(study, setup, rounded)


def _with(study: Study, setup: Setup, scenario: Scenario) -> Episode:
    trunk = undisturbed(study, setup, scenario)
    return Episode(setup=setup, scenario=scenario, begins=begins(trunk, scenario))


def _faulted(scenario: Scenario, faults: tuple[Any, ...]) -> Scenario:
    lab = scenario.lab.model_copy(update={"faults": faults})
    text = f"{', '.join(fault.kind for fault in faults)}"
    return scenario.model_copy(update={"lab": lab, "description": text})


def _rounded(scenario: Scenario, digits: int) -> Scenario:
    """Times to so many decimals, other numbers to so many figures."""
    data = scenario.model_dump()
    for fault in data["lab"]["faults"]:
        for key, value in fault.items():
            if key == "at":
                fault[key] = round(value, digits)
            elif key not in _NEVER_ROUNDED and isinstance(value, float):
                fault[key] = float(f"{value:.{digits}g}")
    data["lab"]["faults"] = sorted(data["lab"]["faults"], key=lambda fault: fault["at"])
    for command in data["operator"]:
        if command["command"] != "start":
            command["at"] = round(command["at"], digits)
    data["operator"] = sorted(data["operator"], key=lambda command: command["at"])
    return Scenario.model_validate(data)
