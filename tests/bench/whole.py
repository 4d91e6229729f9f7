"""The whole thing in virtual time: how many times faster than the robot."""

from __future__ import annotations

import tempfile
from contextlib import closing
from pathlib import Path
from typing import Any

from tests.bench.measure import Figure, fixed_loop_ms
from tonus.config import load
from tonus.runtime.states import Operator
from tonus.runtime.timing.clock import wall_seconds
from tonus.tools.run.composer import Order, run
from tonus.tools.run.held import HeldRobot

SECONDS = 10.0
ROUNDS = 3
AIMS = {"can": 5.0, "ethercat": 5.0, "direct": 10.0}
"""times real time"""
OVERRIDES: dict[str, Any] = {}
"""of the configuration: none"""


def whole() -> list[Figure]:
    """A load test on CAN and on EtherCAT with every frame emulated, and without frames."""
    return [
        Figure("a fixed loop of Python", fixed_loop_ms(), "ms", note="by which hosts compare"),
        *(_virtual(f"config/{bus}.yaml", aim) for bus, aim in AIMS.items()),
        _held("config/can.yaml"),
    ]


def _held(path: str) -> Figure:
    """What a test of one second costs from a robot that is held already, beside one from OFF."""
    config, scenario = load(path, "hold", OVERRIDES)
    scenario = scenario.model_copy(update={"duration": 1.0})
    with tempfile.TemporaryDirectory() as folder:
        began = wall_seconds()
        run(Order(config, scenario, Path(folder, "whole"), 1, True, lambda _: None, live=False))
        whole_s = wall_seconds() - began
        with closing(HeldRobot(config, scenario)) as robot:
            held_s = min(_second(robot, Path(folder, str(number))) for number in range(ROUNDS))
    name = f"a test of one second, {path}, from a held robot"
    return Figure(name, held_s, "s", "from OFF to STANDBY", whole_s, "recording included")


def _second(robot: HeldRobot, out: Path) -> float:
    began = wall_seconds()
    with robot.operated(out) as run:
        run.command(Operator.START)
        run.advance(1.0)
    return wall_seconds() - began


def _virtual(path: str, aim: float) -> Figure:
    config, scenario = load(path, overrides=OVERRIDES)
    scenario = scenario.model_copy(update={"duration": SECONDS})
    with tempfile.TemporaryDirectory() as folder:
        order = Order(config, scenario, Path(folder), 1, True, lambda _: None, live=False)
        result = run(order)
    factor = result.realtime_factor(config.control.rates.period)
    return Figure(f"virtual time, {path}", factor, "x", "aim", aim, "recording included", True)
