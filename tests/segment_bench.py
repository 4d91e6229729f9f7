"""An EtherCAT fieldbus on the lab's segment in virtual time, tick by tick."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

from pydantic import TypeAdapter

from tonus.config import load
from tonus.config.schema.bus import EthercatBus
from tonus.config.schema.faults import Fault
from tonus.config.schema.root import Config
from tonus.drivers.ethercat.deterministic import DeterministicMaster
from tonus.drivers.ethercat.master import EthercatFieldbus
from tonus.drivers.ethercat.ring import injected_ring
from tonus.drivers.fieldbus import BusEvent
from tonus.drivers.process_image import AxisCommand, ProcessImage
from tonus.runtime.timing import clock
from tonus.runtime.timing.scheduler import VirtualPacing
from tonus.runtime.timing.steering import SteeredPacing
from tonus.sim.ethercat.ring import Ring
from tonus.sim.lab.engine import Lab
from tonus.tools.run.supervision import without_relay

Result = TypeVar("Result")
PERIOD_NS = 1_000_000
SYNC0_NS = 50_000
"""after the start of a tick, as configured (`clocks.shift_us`)"""
SEGMENT = "tonus0"
_FAULT: TypeAdapter[Any] = TypeAdapter(Fault)


class SegmentBench:
    """``between`` may change a frame's answer on its way back; ``frames`` counts those sent."""

    def __init__(
        self, overrides: dict[str, Any] | None = None, name: str = "config/ethercat.yaml"
    ) -> None:
        self.config: Config = without_relay(load(name, overrides=overrides)[0])
        self.lab = Lab(
            self.config,
            load("config/ethercat.yaml", scenario="hold")[1].lab,
            seed=1,
            clock=clock.loop_clock(),
        )
        self.segment = self.lab.segments[SEGMENT]
        self._ring = Ring(self.segment)
        self.between: Callable[[bytes, bytes | None], bytes | None] | None = None
        self.image = ProcessImage(8)
        self.fieldbus = EthercatFieldbus(
            self.config,
            self.image,
            self._master,
        )
        self.events: list[BusEvent] = []
        self.said: list[str] = []
        self.tick = -1
        self.due_ns = 0
        self._pacing: SteeredPacing | None = None

    def _master(self, bus: EthercatBus, now_ns: Callable[[], int]) -> DeterministicMaster:
        ring = bus.redundant_interface is not None
        states = injected_ring(self._ring.through, now_ns) if ring else None
        return DeterministicMaster(bus, self._exchange, now_ns, states=states)

    def _exchange(self, frame: bytes, at_ns: int) -> bytes | None:
        answer = self._ring.around(frame, at_ns)
        return self.between(frame, answer) if self.between is not None else answer

    async def start(self) -> None:
        await self.fieldbus.start(self.said.append)
        self._pacing = SteeredPacing(VirtualPacing(), self.fieldbus, self.fieldbus.clocks)
        self.due_ns = (clock.now_ns() // PERIOD_NS + 2) * PERIOD_NS

    async def run(self, ticks: int, each: Callable[[int], None] | None = None) -> None:
        """So many ticks, at the times the scheduler would choose."""
        assert self._pacing is not None
        for _ in range(ticks):
            self.tick += 1
            self.due_ns += self._pacing.steer(self.due_ns)
            await self._pacing.until(self.due_ns)
            self.fieldbus.collect(self.tick)
            if each is not None:
                each(self.tick)
            self.fieldbus.publish(self.tick)
            self.events += self.fieldbus.take_events()
            self.due_ns += PERIOD_NS

    async def enable(self, torque: float = 0.0) -> None:
        """All drives to Operation Enabled with the same small torque."""
        self.image.commands["command"] = AxisCommand.ENABLE
        self.image.commands["torque"] = torque
        await self.run(20)

    def inject(self, kind: str, **fields: Any) -> None:
        self.lab.inject(_FAULT.validate_python({"kind": kind, "channel": SEGMENT, **fields}))

    def named(self, name: str) -> list[BusEvent]:
        return [event for event in self.events if event.name == name]


def run(main: Callable[[], Awaitable[Result]]) -> Result:
    """On a loop in virtual time, to the end."""

    async def whole() -> Result:
        return await main()

    return clock.run(whole(), virtual=True)


async def until(bench: SegmentBench, condition: Callable[[], bool], ticks: int = 2000) -> int:
    """Ticks until something holds."""
    for count in range(ticks):
        if condition():
            return count
        await bench.run(1)
    raise AssertionError(f"did not come about within {ticks} ticks")


async def beside(bench: SegmentBench, work: Awaitable[Result]) -> Result:
    """Ticks go on while something else is waited for."""
    task = asyncio.ensure_future(work)
    while not task.done():
        await bench.run(1)
    return task.result()
