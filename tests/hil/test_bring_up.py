"""The master on the lab's timed buses, in virtual time: bring-up, enabling, pulling a node."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from config import load
from drivers.canopen.master import CanopenFieldbus
from drivers.errors import BringUpError
from drivers.process_image import AxisCommand, AxisState, ProcessImage
from runtime.clock import VirtualTimeLoop

Lab = pytest.importorskip("sim.lab").Lab
CONFIG, SCENARIO = load("config/can.yaml", scenario="hold")
PERIOD_S = CONFIG.control.rates.period


class Bench:
    """Daemon's half and lab's half on one virtual loop."""

    def __init__(self) -> None:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualTimeLoop)
        self.lab = Lab(CONFIG, SCENARIO.lab, seed=1, clock=loop.now_ns)
        self.image = ProcessImage()
        self.frames: list[tuple[int, int, int, bytes, bool]] = []
        self.fieldbus = CanopenFieldbus(
            CONFIG, self.image, lambda *frame: self.frames.append(frame)
        )
        self.tick = 0

    async def ticks(self, count: int) -> None:
        for _ in range(count):
            self.fieldbus.collect(self.tick)
            self.fieldbus.publish(self.tick)
            self.tick += 1
            await asyncio.sleep(PERIOD_S)


def on_lab(script: Callable[[Bench], Awaitable[None]]) -> Bench:
    async def work() -> Bench:
        bench = Bench()
        bench.lab.open()
        try:
            await script(bench)
        finally:
            await bench.fieldbus.stop()
            bench.lab.close()
        return bench

    with asyncio.Runner(loop_factory=VirtualTimeLoop) as runner:
        return runner.run(work())


async def enabled(bench: Bench) -> None:
    await bench.fieldbus.start(lambda _: None)
    bench.image.commands["command"] = AxisCommand.ENABLE
    await bench.ticks(30)
    assert set(bench.image.axes["state"]) == {AxisState.OPERATION_ENABLED}
    assert set(bench.image.axes["age"]) == set(bench.image.cells["age"]) == {0}


def test_all_drives_are_brought_to_operation_enabled_and_back() -> None:
    async def script(bench: Bench) -> None:
        await enabled(bench)
        bench.image.commands["command"] = AxisCommand.DISABLE
        await bench.ticks(30)
        assert set(bench.image.axes["state"]) == {AxisState.SWITCH_ON_DISABLED}
        assert bench.fieldbus.take_events() == []

    on_lab(script)


def test_two_runs_exchange_the_same_frames_at_the_same_times() -> None:
    first, second = on_lab(enabled).frames, on_lab(enabled).frames
    assert len(first) > 1000
    assert first == second


def test_a_node_that_is_pulled_is_lost_and_told() -> None:
    async def script(bench: Bench) -> None:
        await enabled(bench)
        bench.lab.unplug("can1", 3)
        await bench.ticks(CONFIG.control.freshness.measurement_ticks + 3)
        states = bench.image.axes["state"].tolist()
        assert states.pop(2) == AxisState.LOST
        assert set(states) == {AxisState.OPERATION_ENABLED}
        await bench.ticks(300)
        told = [(event.name, event.where) for event in bench.fieldbus.take_events()]
        assert ("heartbeat_lost", "can1/3") in told

    on_lab(script)


def test_a_node_that_is_missing_is_named() -> None:
    async def script(bench: Bench) -> None:
        bench.lab.unplug("can3", 25)
        with pytest.raises(BringUpError, match=r"^1 of 17 .* can3/25 \(force cell 8\): missing"):
            await bench.fieldbus.start(lambda _: None)

    on_lab(script)
