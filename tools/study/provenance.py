"""What the rows of a study depend on beside its own file: the code and the configurations."""

from __future__ import annotations

from hashlib import sha256
from importlib.metadata import version
from typing import Any

import tonus.tools.study
from tonus.config import load
from tonus.config.schema.parameter_study import ParameterStudy
from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.tools.campaign.journal import code_digest
from tonus.tools.study.trials import Trial, trials


def firsts(study: ParameterStudy) -> list[Trial]:
    """The first trial of each configuration, scenario and controller."""
    found: dict[tuple[str, str, str | None], Trial] = {}
    for trial in trials(study):
        found.setdefault((trial.config, trial.scenario, trial.controller), trial)
    return list(found.values())


def configuration_digest(*parts: Config | Scenario) -> str:
    """Of every value, whichever files they are from; a trajectory is in it with its samples."""
    return sha256(b"\0".join(each.model_dump_json().encode() for each in parts)).hexdigest()[:16]


def head(study: ParameterStudy) -> dict[str, Any]:
    """A journal's first line: all that its rows depend on. Raises `ConfigError`."""
    parts = [part for each in firsts(study) for part in loaded(study, each)]
    return {
        "study": study.model_dump(mode="json"),
        "version": version("tonus"),
        "code": code_digest(tonus.tools.study),
        "configuration": configuration_digest(*parts),
    }


def loaded(study: ParameterStudy, trial: Trial) -> tuple[Config, Scenario]:
    """What the trial is played with. Raises `ConfigError`."""
    config, scenario = load(trial.config, trial.scenario, trial.overrides(study))
    if study.duration is not None:
        scenario = scenario.model_copy(update={"duration": study.duration})
    return config, scenario
