"""By which settings runs differ: key by key of what their logs hold."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from tonus.tools.log import Log
from tonus.tools.log.attached import configuration, played

_SHOWN = 12
_ABSENT = "none"


def differences(logs: Sequence[Log]) -> list[str]:
    """One line for each key of configuration or scenario that is not the same in all logs, with the
    value of each. Raises `ToolError` for a log without them."""
    settings = [
        _flat("", configuration(log)) | _flat("scenario.", played(log)) | {"seed": _seed(log)}
        for log in logs
    ]
    names = _names([log.path for log in logs])
    keys = list(dict.fromkeys(key for each in settings for key in each))
    found = []
    for key in keys:
        values = [each.get(key, _ABSENT) for each in settings]
        if len(set(values)) > 1:
            told = ", ".join(f"{v} in {name}" for v, name in zip(values, names, strict=True))
            found.append(f"{key}: {told}")
    return found


def shown(found: Sequence[str]) -> list[str]:
    """As many lines as a person reads."""
    if len(found) <= _SHOWN:
        return list(found)
    return [*found[:_SHOWN], f"and {len(found) - _SHOWN} more; --json has them all"]


def _names(paths: Sequence[Path]) -> list[str]:
    """Files by as much of their path as tells them apart."""
    for length in range(1, max(len(path.parts) for path in paths) + 1):
        names = ["/".join(path.parts[-length:]) for path in paths]
        if len(set(names)) == len(set(paths)):
            return names
    return [str(path) for path in paths]


def _seed(log: Log) -> str:
    return log.metadata.get("seed", _ABSENT)


def _flat(prefix: str, model: BaseModel) -> dict[str, str]:
    found: dict[str, str] = {}

    def add(key: str, value: Any) -> None:
        if isinstance(value, dict):
            for name, inner in value.items():
                add(f"{key}.{name}", inner)
        elif isinstance(value, list) and any(isinstance(each, dict | list) for each in value):
            for index, inner in enumerate(value):
                add(f"{key}.{index}", inner)
        else:
            found[key] = str(value)

    for name, value in model.model_dump(mode="json").items():
        add(f"{prefix}{name}", value)
    return found
