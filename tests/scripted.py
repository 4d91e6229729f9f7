"""Shipped scenarios with a script of a test's own for the lab or the operator."""

from __future__ import annotations

from typing import Any

from tonus.config import Scenario
from tonus.config.loader import load_scenario


def scripted(name: str = "hold", **keys: Any) -> Scenario:
    """A shipped scenario in which keys have other values, such as ``lab`` or ``operator``."""
    return Scenario.model_validate(load_scenario(name).model_dump() | keys)
