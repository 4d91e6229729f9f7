"""Episodes drawn from a study: the same for the same seed, whatever became of those before."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from tonus.config.loader import load_scenario
from tonus.config.schema.campaign import BusName, Choice, Kind, Span, Struck, Study
from tonus.config.schema.control import Sequence as Bringup
from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Command, Scenario
from tonus.tools.campaign.coverage import Pairs
from tonus.tools.campaign.episode import Episode, Group, Setup
from tonus.tools.campaign.places import places
from tonus.tools.errors import ToolError

Generator = np.random.Generator
Name = TypeVar("Name", bound=str)
_COUNTS = {"one": 1, "two": 2, "three": 3}
_SETUPS, _EPISODES = 1, 2
"""streams of a campaign's seed"""
_SPARE_S = 0.1
"""after arming: by then every drive is enabled, and faults have a time"""
_GRID_S = 1e-4


@dataclass(frozen=True)
class Timeline:
    """When an undisturbed run is where; s after arming."""

    referenced: float
    held: float
    """in HOLD from here on"""
    started: float
    """the operator starts the scenario"""

    @classmethod
    def of(cls, bringup: Bringup, hold: float) -> Timeline:
        referenced = bringup.referencing_settle_s + bringup.referencing_average_s
        lifted = bringup.pretension_s + bringup.lift_s + 1.0 / bringup.reference_slew
        held = referenced + lifted + _SPARE_S
        return cls(referenced, held, held + hold)


def setups(study: Study, seed: int, buses: Sequence[BusName]) -> Iterator[tuple[Setup, str]]:
    """Setups with their scenarios' names, without end."""
    number = 0
    while True:
        random = np.random.default_rng([seed, _SETUPS, number])
        bus = buses[number % len(buses)]
        overrides = study.overrides | study.bus_overrides.get(bus, {})
        overrides["control.controller"] = str(random.choice(study.controllers))
        if random.random() < study.plants.drawn:
            overrides |= study.plants.overrides
        config, name = random.choice(study.configs[bus]), random.choice(study.scenarios)
        lab_seed = int(random.integers(1, 1_000_000))
        yield Setup(config=str(config), seed=lab_seed, overrides=overrides), str(name)
        number += 1


def undisturbed(study: Study, setup: Setup, scenario: Scenario) -> Scenario:
    """A scenario without any fault: brought up, held for a while, and then active."""
    timeline = Timeline.of(setup.settle().control.sequence, study.times.hold)
    start = Command(at=timeline.started, command="start")
    lab = scenario.lab.model_copy(update={"faults": ()})
    update = {"operator": (start,), "duration": study.times.longest, "lab": lab}
    named = {"name": study.name, "description": "undisturbed"}
    return scenario.model_copy(update=update | named)


def episodes(study: Study, seed: int, buses: Sequence[BusName], count: int) -> list[Episode]:
    """The first ``count`` episodes of a campaign. Raises `ConfigError` and `ToolError`."""
    pairs = Pairs()
    found: list[Episode] = []
    for setup, name in setups(study, seed, buses):
        if len(found) >= count:
            return found
        base, config = undisturbed(study, setup, load_scenario(name)), setup.settle()
        for index in range(len(found), min(len(found) + study.group, count)):
            random = np.random.default_rng([seed, _EPISODES, index])
            episode = _Draw(study, config, base, random, pairs).episode(setup, index)
            assert episode.state is not None
            pairs.add(episode.state, episode.kinds)
            found.append(episode)
    return found


def grouped(study: Study, chosen: Iterable[Episode]) -> list[Group]:
    """Episodes with the undisturbed runs they start from, those of equal ones together."""
    found: dict[str, tuple[Scenario, list[Episode]]] = {}
    for episode in chosen:
        trunk = undisturbed(study, episode.setup, episode.scenario)
        key = episode.setup.model_dump_json() + trunk.model_dump_json()
        found.setdefault(key, (trunk, []))[1].append(episode)
    return [
        Group(trunk, some[first : first + study.group])
        for trunk, some in found.values()
        for first in range(0, len(some), study.group)
    ]


def begins(trunk: Scenario, scenario: Scenario) -> float:
    """s after arming up to which a scenario is its undisturbed one."""
    own = [each.at for each in scenario.operator if each not in trunk.operator]
    left = [each.at for each in trunk.operator if each not in scenario.operator]
    return min([*(fault.at for fault in scenario.lab.faults), *own, *left], default=0.0)


class _Draw:
    """One episode being drawn."""

    def __init__(
        self, study: Study, config: Config, base: Scenario, random: Generator, pairs: Pairs
    ) -> None:
        self._study, self._config, self._base = study, config, base
        self._random, self._pairs = random, pairs
        self._timeline = Timeline.of(config.control.sequence, study.times.hold)
        self._kinds = self._left()

    def episode(self, setup: Setup, index: int) -> Episode:
        study, random = self._study, self._random
        state = _weighted(random, study.states)
        kinds = self._some(state, _COUNTS[_weighted(random, study.faults)])
        commands = self._path(state)
        first = self._first(state, commands)
        moments = first + np.sort(random.uniform(0.0, study.times.apart, len(kinds)))
        moments[0] = first
        faults = [self._fault(kind, at) for kind, at in zip(kinds, moments, strict=True)]
        if random.random() < study.commands.chance:
            commands += self._interference(first)
        last = _grid(float(moments[-1]) + random.uniform(*study.times.after))
        commands = sorted((each for each in commands if each.at < last), key=lambda each: each.at)
        commands.append(Command(at=last, command="stop"))
        data = self._base.model_dump()
        data["lab"]["faults"] = faults
        data["operator"] = [command.model_dump() for command in commands]
        data["name"], data["description"] = f"faults_{index}", f"{', '.join(kinds)} in {state}"
        scenario = Scenario.model_validate(data)
        return Episode(
            setup=setup,
            scenario=scenario,
            begins=begins(self._base, scenario),
            state=state,
            index=index,
        )

    def _left(self) -> dict[str, Kind]:
        """The kinds that fit, less those left out at random; never none."""
        study, name = self._study, self._config.fieldbus.faults
        phantom = self._base.lab.phantom is not None
        fit = {
            kind: spec
            for kind, spec in study.kinds.items()
            if name in spec.buses and (phantom or not spec.phantom)
        }
        if not fit:
            raise ToolError(f"study {study.name}: has no kind of fault for the bus {name}")
        some = {kind: spec for kind, spec in fit.items() if self._random.random() > study.left_out}
        return some or fit

    def _some(self, state: Struck, count: int) -> list[str]:
        """Kinds of faults, those rather that were together least."""
        names = list(self._kinds)
        chosen = [str(self._random.choice(names))]
        while len(chosen) < count:
            if self._random.random() < self._study.steered:
                seen = [self._pairs.count(state, chosen[0], name) for name in names]
                least = [name for name, n in zip(names, seen, strict=True) if n == min(seen)]
                chosen.append(str(self._random.choice(least)))
            else:
                chosen.append(str(self._random.choice(names)))
        return chosen

    def _path(self, state: Struck) -> list[Command]:
        """The commands that lead to a state."""
        start, times = self._base.operator[0], self._study.times
        if state in ("REFERENCING", "PRETENSION", "HOLD"):
            return []
        if state == "ACTIVE":
            return [start]
        stop = _grid(start.at + self._random.uniform(0.1, times.active))
        return [start, Command(at=stop, command="stop")]

    def _first(self, state: Struck, commands: list[Command]) -> float:
        """s after arming in which the first fault strikes."""
        timeline, random, times = self._timeline, self._random, self._study.times
        sequence = self._config.control.sequence
        if state == "REFERENCING":
            return float(random.uniform(_SPARE_S, timeline.referenced))
        if state == "PRETENSION":
            return float(random.uniform(timeline.referenced + _SPARE_S, timeline.held - _SPARE_S))
        if state == "HOLD":
            return float(random.uniform(timeline.held, timeline.started))
        begun = commands[-1].at
        if state == "ACTIVE":
            return begun + float(random.uniform(0.0, times.active))
        if state == "SAFE_STOP":
            return begun + float(random.uniform(0.0, sequence.stop_s))
        return begun + sequence.stop_s + float(random.uniform(0.0, sequence.lower_s))

    def _interference(self, first: float) -> list[Command]:
        """Commands round about the first fault."""
        commands, random = self._study.commands, self._random
        count = int(random.integers(1, commands.most + 1))
        times = first + random.uniform(-0.2, self._study.times.apart, count)
        return [
            Command(at=_grid(max(float(at), _SPARE_S)), command=random.choice(commands.any_of))
            for at in times
        ]

    def _fault(self, name: str, at: float) -> dict[str, Any]:
        kind, random = self._kinds[name], self._random
        where = places(self._config, kind.at)
        if not where:
            raise ToolError(f"study {self._study.name}: a {name} has no {kind.at} on this bus")
        drawn = {key: _value(random, spec) for key, spec in kind.values.items()}
        chosen = where[int(random.integers(len(where)))]
        return {"kind": name, "at": _grid(at), **chosen, **drawn}


def _value(random: Generator, spec: Span | Choice) -> Any:
    if isinstance(spec, Choice):
        return spec.any_of[int(random.integers(len(spec.any_of)))]
    if spec.size is not None:
        return [float(each) for each in random.uniform(spec.low, spec.high, spec.size)]
    if spec.log:
        low, high = np.log([spec.low, spec.high])
        value = float(np.exp(random.uniform(low, high)))
    elif spec.whole:
        return int(random.integers(round(spec.low), round(spec.high) + 1))
    else:
        value = float(random.uniform(spec.low, spec.high))
    return round(value) if spec.whole else float(f"{value:.4g}")


def _weighted(random: Generator, weights: dict[Name, float]) -> Name:
    shares = np.array(list(weights.values()))
    return list(weights)[int(random.choice(len(shares), p=shares / shares.sum()))]


def _grid(at: float) -> float:
    """A time as a file shows it."""
    return round(round(at / _GRID_S) * _GRID_S, 6)
