"""A violation kept: a scenario that `tonus run` plays, and beside it what else it takes."""

from __future__ import annotations

from pathlib import Path

import yaml
from pydantic import ValidationError

from tonus.config.document import read
from tonus.config.schema.base import Section
from tonus.config.schema.scenario import Scenario
from tonus.tools.campaign.episode import Episode, Setup
from tonus.tools.errors import ToolError
from tonus.tools.settings import settings_of

SUFFIX = ".episode.yaml"


class Regression(Section):
    """An episode that once broke a bound."""

    broke: str
    """the invariant"""
    setup: Setup
    scenario: Scenario

    @property
    def episode(self) -> Episode:
        return Episode(setup=self.setup, scenario=self.scenario)


def write(folder: Path, name: str, episode: Episode, invariant: str) -> Path:
    """Two files in ``folder``; returns the scenario's. Raises `OSError`."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.yaml"
    setup = episode.setup
    options = " ".join(settings_of(setup.overrides))
    scenario = episode.scenario.model_dump(mode="json", exclude_defaults=True)
    path.write_text(
        f"# Broke {invariant}. Without the robot's spreads and the quick start:\n"
        f"#   tonus run {setup.config} --virtual --seed {setup.seed} --scenario {path.name}\n"
        f"# as it was: {options}\n" + yaml.safe_dump(scenario, sort_keys=False, width=100),
        encoding="utf-8",
    )
    told = yaml.safe_dump(
        {"broke": invariant, "setup": setup.model_dump(mode="json")}, sort_keys=False, width=100
    )
    (folder / f"{name}{SUFFIX}").write_text(
        f"{told}scenario: !include {path.name}\n", encoding="utf-8"
    )
    return path


def load(path: Path) -> Regression:
    """What `write` wrote: the file with the setup. Raises `ConfigError` and `ToolError`."""
    try:
        return Regression.model_validate(read(path).data)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise ToolError(f"{path}: {place}: {first['msg']}") from error
