"""Daemon's half and lab's half of a CANopen configuration on one virtual loop."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import can

from tests.unit.fake_can import Tap
from tonus.config import Config, load
from tonus.drivers.canopen.master import CanopenFieldbus
from tonus.drivers.process_image import AxisCommand, AxisState, ProcessImage
from tonus.runtime.timing.clock import VirtualTimeLoop
from tonus.sim.lab.engine import Lab

CONFIG, SCENARIO = load("config/can.yaml", scenario="hold", overrides={"supervisor.policy": "off"})
PERIOD_S = CONFIG.control.rates.period


class Bench:
    """The fieldbus and the lab; ``tick`` is the next one."""

    def __init__(
        self, open_bus: Callable[[str], can.BusABC] | None = None, config: Config = CONFIG
    ) -> None:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualTimeLoop)
        self.lab = Lab(config, SCENARIO.lab, seed=1, clock=loop.now_ns)
        self.image = ProcessImage(config.robot.cables)
        tap = Tap()
        self.frames = tap.seen
        self.fieldbus = CanopenFieldbus(config, self.image, tap, open_bus=open_bus)
        self.tick = 0

    async def ticks(self, count: int) -> None:
        for _ in range(count):
            self.fieldbus.collect(self.tick)
            self.fieldbus.publish(self.tick)
            self.tick += 1
            await asyncio.sleep(PERIOD_S)


def on_lab(
    script: Callable[[Bench], Awaitable[None]],
    open_bus: Callable[[str], can.BusABC] | None = None,
    config: Config = CONFIG,
) -> Bench:
    """Play a script on a bench of its own, in virtual time."""

    async def work() -> Bench:
        bench = Bench(open_bus, config)
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
    """Bring up, and enable every drive."""
    await bench.fieldbus.start(lambda _: None)
    bench.image.commands["command"] = AxisCommand.ENABLE
    await bench.ticks(30)
    assert set(bench.image.axes["state"]) == {AxisState.OPERATION_ENABLED}
    assert set(bench.image.axes["age"]) == set(bench.image.cells["age"]) == {0}
