"""The whole thing in virtual time: how many times faster than the robot."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from tests.bench.measure import Figure
from tonus.config import load
from tonus.tools.run.composer import Order, run

SECONDS = 10.0
OVERRIDES: dict[str, Any] = {}
"""of the configuration: none"""


def whole() -> list[Figure]:
    """A load test on CAN and on EtherCAT with every frame emulated, and without frames."""
    can = _virtual("config/can.yaml")
    return [
        can,
        replace(_virtual("config/ethercat.yaml"), peer="on CAN", peer_value=can.value),
        _virtual("config/direct.yaml"),
    ]


def _virtual(path: str) -> Figure:
    config, scenario = load(path, overrides=OVERRIDES)
    scenario = scenario.model_copy(update={"duration": SECONDS})
    with tempfile.TemporaryDirectory() as folder:
        order = Order(config, scenario, Path(folder), 1, True, lambda _: None, live=False)
        result = run(order)
    factor = result.realtime_factor(config.control.rates.period)
    return Figure(f"virtual time, {path}", factor, "x", "real time", 1.0, "recording included")
