"""`--set KEY=VALUE`: single values of a configuration from the command line."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import yaml

from tonus.tools.errors import ToolError


def overrides_of(settings: Iterable[str]) -> dict[str, Any]:
    """Dotted keys with their values, read as YAML. Raises `ToolError`."""
    found: dict[str, Any] = {}
    for each in settings:
        key, sign, text = each.partition("=")
        if not sign or not key.strip():
            raise ToolError(f"--set {each}: write KEY=VALUE, as control.stiffness.base=3000")
        try:
            found[key.strip()] = yaml.safe_load(text)
        except yaml.YAMLError as error:
            raise ToolError(f"--set {each}: the value is not YAML") from error
    return found


def settings_of(overrides: dict[str, Any]) -> list[str]:
    """The options that give these overrides again."""
    return [
        f"--set {key}={yaml.safe_dump(value, default_flow_style=True).split(chr(10))[0]}"
        for key, value in overrides.items()
    ]
