"""One episode: all that it takes to play it again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from pydantic import Field

from tonus.config import load
from tonus.config.schema.base import Section
from tonus.config.schema.campaign import Struck
from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario


class Setup(Section):
    """What episodes that start from one bring-up have in common."""

    config: str
    seed: int
    """of the lab: noise, and the robot where one is drawn"""
    overrides: dict[str, Any] = Field(default_factory=dict)
    """dotted keys of the configuration"""

    def settle(self) -> Config:
        """Raises `ConfigError`."""
        return _settled(self.model_dump_json())


@lru_cache(maxsize=8)
def _settled(text: str) -> Config:
    setup = Setup.model_validate_json(text)
    return load(setup.config, None, setup.overrides)[0]


class Episode(Section):
    """A setup and what happens in it: the scenario holds faults and commands, and `tonus run` plays
    it."""

    setup: Setup
    scenario: Scenario
    begins: float | None = None
    """s after arming up to which it is the same as its undisturbed setup; None: plays from OFF"""
    state: Struck | None = None
    """in which the first fault is meant to strike"""
    index: int = 0
    """in its campaign"""

    @property
    def kinds(self) -> tuple[str, ...]:
        return tuple(fault.kind for fault in self.scenario.lab.faults)


@dataclass(frozen=True)
class Group:
    """Episodes of one setup, and the scenario that they share until they begin."""

    undisturbed: Scenario
    episodes: Sequence[Episode]
