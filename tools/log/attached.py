"""What a log was recorded with, as its attachments have it: configuration and scenarios."""

from __future__ import annotations

from typing import TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.tools.documents import from_yaml
from tonus.tools.errors import ToolError
from tonus.tools.log.log import Log

Model = TypeVar("Model", bound=BaseModel)


class _Catalogue(BaseModel):
    scenarios: tuple[Scenario, ...]


def configuration(log: Log) -> Config:
    """What the log was recorded with. Raises ToolError."""
    text = log.config_text
    if text is None:
        raise ToolError(f"{log.path}: holds no configuration, so it cannot be replayed")
    return _validated(log, text, Config, "configuration")


def played(log: Log) -> Scenario:
    """The scenario of the log. Raises ToolError."""
    data = log.attachments.get("scenario.yaml")
    if data is None:
        raise ToolError(f"{log.path}: holds no scenario, so it cannot be replayed")
    return _validated(log, data.decode(errors="replace"), Scenario, "scenario")


def catalogue(log: Log) -> list[Scenario]:
    """What else an operator could choose, in the order of the numbers it is known by. Raises
    ToolError."""
    data = log.attachments.get("catalogue.yaml")
    if data is None:
        return []
    text = data.decode(errors="replace")
    return list(_validated(log, text, _Catalogue, "catalogue").scenarios)


def _validated(log: Log, text: str, model: type[Model], what: str) -> Model:
    try:
        return model.model_validate(from_yaml(text))
    except (ValidationError, yaml.YAMLError) as error:
        found = error.errors()[0] if isinstance(error, ValidationError) else None
        if found and found["loc"] == ("control", "controller"):
            raise ToolError(
                f"{log.path}: its controller {found['input']!r} is not installed here; install the "
                "distribution that registers it (environment.txt in the log has its version)"
            ) from error
        if found and found["loc"] == ("fieldbus",):
            raise ToolError(
                f"{log.path}: fieldbus: {found['msg'].removeprefix('Value error, ')}; install the "
                "distribution that has this kind (environment.txt in the log has its version)"
            ) from error
        place = ".".join(map(str, found["loc"])) if found else "it"
        said = f"{place}: {found['msg']}" if found else "it is not YAML"
        raise ToolError(
            f"{log.path}: its {what} does not fit this version ({said}); "
            "replay it with the version that recorded it"
        ) from error
