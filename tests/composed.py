"""Runs given to the composer itself: for its own tests, for those that choose a run's first tick or
its pacing, and for scripts without pytest. Others take the plugin's fixtures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.loop import QUICK
from tonus.config import Config, Scenario, load
from tonus.tools.log import Log
from tonus.tools.log import open as open_log
from tonus.tools.run.composer import Order, Result, run


def configured(
    path: str = "config/can.yaml",
    scenario: str = "hold",
    *,
    duration: float = 0.5,
    overrides: dict[str, Any] | None = None,
    script: dict[str, Any] | None = None,
) -> tuple[Config, Scenario]:
    """A configuration brought up quickly, and a scenario of ``duration`` s whose lab script may be
    replaced."""
    config, played = load(path, scenario, QUICK | (overrides or {}))
    data = played.model_dump()
    data["duration"] = duration
    if script is not None:
        data["lab"] = script
    return config, Scenario.model_validate(data)


def virtual(
    config: Config, scenario: Scenario, out: Path, *, seed: int = 1, start_ns: int = 0
) -> tuple[Result, Log]:
    """Carry out a run in virtual time, without a word."""
    order = Order(config, scenario, out, seed, True, lambda _: None, live=False, start_ns=start_ns)
    result = run(order)
    return result, open_log(result.log)
