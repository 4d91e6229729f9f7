"""The relay of the STO inputs on a bench: its channel in the lab, a supervisor by hand, and
the daemon's side of it beside a segment that does nothing."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import can

from tonus.config import Config, load
from tonus.config.schema.lab import LabScript
from tonus.config.schema.sto_relay import StoRelay
from tonus.drivers.canopen.sto_relay import RelayedFieldbus
from tonus.drivers.errors import DriverError
from tonus.drivers.fieldbus import BusEvent, Progress
from tonus.drivers.process_image import AxisCommand, ProcessImage
from tonus.runtime.timing import clock
from tonus.sim.devices.output_node import OutputNode
from tonus.sim.lab.engine import Lab

PATH = "config/ethercat.yaml"
ROBOT: dict[str, Any] = {"sto_relay.timeout_ms": 7, "supervisor.period_ms": 2}
SUPERVISOR = 126
LONGEST_S = 5.0
"""of the robot's time, in which a test has ended: one that waits for what never comes fails"""


class Segment:
    """The fieldbus beside it, which has nothing to do."""

    channels = ("none",)

    def __init__(self) -> None:
        self.image = ProcessImage(8)
        self.image.commands["command"] = AxisCommand.DISABLE
        self.done: list[str] = []
        self.fails = False

    async def start(self, progress: Progress) -> None:
        del progress
        self.done.append("start")
        if self.fails:
            raise DriverError("no slaves")

    def collect(self, tick: int) -> None:
        self.done.append(f"collect {tick}")

    def publish(self, tick: int) -> None:
        self.done.append(f"publish {tick}")

    def take_events(self) -> list[BusEvent]:
        return [BusEvent("frame_lost", "none", "its own")]

    async def sdo_read(self, axis: int, index: int, subindex: int) -> bytes:
        return bytes((axis, subindex))

    async def sdo_write(self, axis: int, index: int, subindex: int, data: bytes) -> None:
        self.done.append(f"write {axis} {index:04X}:{subindex} {data.hex()}")

    async def recover(self) -> None:
        self.done.append("recover")

    async def stop(self) -> None:
        self.done.append("stop")


class Bench:
    """A lab in virtual time with the relay's channel, a supervisor by hand, and the daemon's side.
    Use `play`."""

    def __init__(self, **overrides: Any) -> None:
        self.config: Config = load(PATH, overrides={**ROBOT, **overrides})[0]
        assert self.config.relay is not None
        self.relay: StoRelay = self.config.relay
        self.beats = self.holds = False
        self.segment = Segment()
        self.events: list[BusEvent] = []
        self.tick = 0

    def play(self, act: Callable[[Bench], Awaitable[None]]) -> None:
        async def main() -> None:
            now = clock.loop_clock()
            self.lab = Lab(self.config, LabScript(), seed=1, clock=now)
            self.lab.open()
            self.bus = can.Bus(interface="tonus", channel=self.relay.channel)
            self.fieldbus = RelayedFieldbus(self.config, self.segment)
            try:
                async with asyncio.timeout(LONGEST_S):
                    await act(self)
            finally:
                await self.fieldbus.stop()
                self.bus.shutdown()
                self.lab.close()

        clock.run(main(), virtual=True)

    @property
    def node(self) -> OutputNode:
        device = self.lab.nodes[self.relay.channel, self.relay.node_id].device
        assert isinstance(device, OutputNode)
        return device

    @property
    def closed(self) -> bool:
        self.lab.advance(clock.now_ns())
        return not self.node.inputs & 1

    @property
    def torque_off(self) -> list[bool]:
        self.lab.advance(clock.now_ns())
        return [drive.objects.find(0x3202, 1).get() == 0 for drive in self.lab.drives]

    @property
    def obstacles(self) -> dict[str, str]:
        return self.segment.image.obstacles

    def names(self) -> list[str]:
        return [event.name for event in self.events if event.where != "none"]

    def send(self, identifier: int, data: bytes) -> None:
        self.bus.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=data))

    def object(self, index: int, subindex: int) -> int:
        return self.node.objects.number(index, subindex)

    async def start(self) -> None:
        await self.fieldbus.start(lambda _: None)

    async def pass_ms(self, count: int) -> None:
        """Ticks, and the supervisor's two frames in every second one."""
        for _ in range(count):
            if self.tick % 2 == 0:
                if self.beats:
                    self.send(0x700 + SUPERVISOR, b"\5")
                if self.holds:
                    self.send(0x200 + self.relay.node_id, b"\1")
            self.fieldbus.collect(self.tick)
            self.fieldbus.publish(self.tick)
            self.events += self.fieldbus.take_events()
            self.tick += 1
            await asyncio.sleep(0.001)

    async def held(self) -> None:
        """Closed, by a supervisor that beats."""
        await self.start()
        self.beats = self.holds = True
        await self.pass_ms(40)
        assert self.closed
        assert self.obstacles == {}


def played(**overrides: Any) -> Callable[[Callable[[Bench], Awaitable[None]]], Callable[[], None]]:
    """A test on a bench."""

    def made(act: Callable[[Bench], Awaitable[None]]) -> Callable[[], None]:
        def test() -> None:
            Bench(**overrides).play(act)

        test.__doc__ = act.__doc__
        return test

    return made
