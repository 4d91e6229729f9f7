"""Whether a configuration's controllers are tuned alike: held against what `tonus tune` wrote."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml

from tonus.config import load
from tonus.config.loader import HERE, load_tuning
from tonus.config.schema.root import Config
from tonus.tools.errors import ToolError
from tonus.tools.tune.search import present

SHIPPED = "config/tuned.yaml"
_SHIPPED_FOR = "config/direct.yaml"


def robot_key(config: Config) -> str:
    """Of the robot that gains belong to."""
    told = json.dumps(config.robot.model_dump(mode="json"), sort_keys=True)
    return hashlib.sha256(told.encode()).hexdigest()[:16]


def not_tuned(config: Config, controllers: Iterable[str], file: Path | None = None) -> str:
    """Why a comparison of ``controllers`` compares their gains too, in words; empty where all were
    tuned for this robot with one budget. ``file`` is what `tonus tune` wrote, without it the
    package's. Raises `ToolError` for a file that is none."""
    found, name = _read(file)
    if found.get("robot", robot_key(load(_SHIPPED_FOR)[0])) != robot_key(config):
        return f"{name} is of another robot than {config.name}"
    rules = load_tuning().controllers
    rows = found["controllers"]
    for controller in controllers:
        if controller not in rules:
            continue  # it has no gains
        row = rows.get(controller)
        if row is None:
            return f"{name} has no gains of {controller}"
        if row.get("failed_in"):
            return f"the gains of {controller} in {name} failed in {', '.join(row['failed_in'])}"
        if row["evaluations"] != found["evaluations"]:
            return f"{controller} was tuned with {row['evaluations']} simulations, not the budget"
        for key, value in present(config, row["gains"]).items():
            if value != row["gains"][key]:
                tuned = f"{row['gains'][key]:g} in {name}"
                return f"control.{key} is {value:g} in {config.name} and {tuned}"
    return ""


def _read(file: Path | None) -> tuple[dict[str, Any], str]:
    name = SHIPPED if file is None else str(file)
    path = HERE / "tuned.yaml" if file is None else file
    try:
        found = yaml.safe_load(path.read_text(encoding="utf-8"))
        whole = all({"gains", "evaluations"} <= set(row) for row in found["controllers"].values())
        if not whole or not isinstance(found["evaluations"], int):
            raise KeyError("gains")
    except OSError as error:
        raise ToolError(f"{name}: {(error.strerror or 'unreadable').lower()}") from error
    except (yaml.YAMLError, KeyError, TypeError, AttributeError, UnicodeDecodeError) as error:
        raise ToolError(f"{name}: was not written by tonus tune; name such a file") from error
    return found, name
