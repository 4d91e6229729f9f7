"""The contract of `tonus.drivers.fieldbus.Fieldbus`, tried on a configuration in its lab."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Iterator
from typing import Any

import numpy as np

from tonus.config.schema.lab import LabScript
from tonus.config.schema.root import Config
from tonus.drivers.errors import DriverError
from tonus.drivers.fieldbus import BusEvent, Fieldbus
from tonus.drivers.process_image import NEVER, AxisCommand, AxisState, ProcessImage
from tonus.runtime.timing import clock
from tonus.sim.lab.engine import Lab
from tonus.tools.run import fieldbuses
from tonus.tools.run.supervision import without_relay

SETTLE_TICKS = 50
"""until every measurement has to be there, and every drive in the state that was asked for"""
_STATUSWORD, _TARGET_TORQUE = 0x6041, 0x6071
_NO_OBJECT = 0x0001


def violations(config: Config) -> list[str]:
    """What the fieldbus of a configuration with a lab does against the contract, one line each;
    empty for none. Takes a second or two, in virtual time. Raises what a run would raise for a
    configuration that cannot be started."""
    return clock.run(_Trial(without_relay(config)).play(), virtual=True)


class _Trial:
    def __init__(self, config: Config) -> None:
        self._config = config
        self._image = ProcessImage(config.robot.cables)
        self._found: list[str] = []
        self._tick = 0
        self._ages = [np.full(len(each), NEVER) for each in (self._image.axes, self._image.cells)]
        """least age of each axis' and each cell's measurement: one may be lost now and then"""

    def _must(self, kept: bool, text: str) -> None:
        if not kept and text not in self._found:
            self._found.append(text)

    async def play(self) -> list[str]:
        lab = Lab(self._config, LabScript(), seed=1, clock=clock.loop_clock())
        lab.open()
        try:
            bus = fieldbuses.build(self._config, self._image, lab)
            await self._start(bus)
            try:
                await self._exchange(bus, lab)
                await self._while_ticking(bus, self._objects(bus))
                await self._without_torque(bus, lab)
                await self._while_ticking(bus, bus.recover())
                await self._ticks(bus, SETTLE_TICKS)
                self._must(self._all_enabled(), "recover disturbs drives that are well")
            finally:
                await bus.stop()
            await asyncio.sleep(0.1)
            lab.advance(clock.now_ns())
            still = [drive.axis for drive in lab.drives if drive.enabled]
            self._must(not still, f"stop leaves the drives of axes {still} enabled")
        finally:
            lab.close()
        return self._found

    async def _start(self, bus: Fieldbus) -> None:
        said: list[str] = []
        self._must(bus.image is self._image, "image is not the one that it was built with")
        names = isinstance(bus.channels, tuple) and all(isinstance(n, str) for n in bus.channels)
        self._must(names, "channels is not a tuple of names")
        await bus.start(said.append)
        short = all(line and "\n" not in line for line in said)
        self._must(bool(said) and short, "start reports no progress in lines of text")

    async def _ticks(self, bus: Fieldbus, count: int) -> None:
        period = self._config.control.rates.period_ns
        start = clock.now_ns()
        for index in range(count):
            bus.collect(self._tick)
            bus.publish(self._tick)
            for least, table in zip(self._ages, (self._image.axes, self._image.cells), strict=True):
                np.minimum(least, table["age"], out=least)
            self._see(bus.take_events())
            self._tick += 1
            await asyncio.sleep(max(start + (index + 1) * period - clock.now_ns(), 0) * 1e-9)

    async def _while_ticking(self, bus: Fieldbus, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        while not task.done():
            await self._ticks(bus, 1)
        await task

    def _see(self, events: list[BusEvent]) -> None:
        for event in events:
            complete = isinstance(event, BusEvent) and event.name and event.where and event.text
            self._must(bool(complete), f"event {event!r} has no name, place or text")
            self._must("\n" not in event.text, f"event {event.name} has more than one line")

    async def _exchange(self, bus: Fieldbus, lab: Lab) -> None:
        image = self._image
        image.commands["command"] = AxisCommand.DISABLE
        image.commands["torque"] = 0.0
        await self._ticks(bus, SETTLE_TICKS)
        for problem in self._measured():
            self._must(False, problem)
        self._must(not bus.take_events(), "take_events gives events again that were taken")
        enabled = [drive.axis for drive in lab.drives if drive.enabled]
        self._must(not enabled, f"AxisCommand.DISABLE leaves the drives of axes {enabled} enabled")
        image.commands["command"] = AxisCommand.ENABLE
        await self._ticks(bus, SETTLE_TICKS)
        self._must(self._all_enabled(), "AxisCommand.ENABLE does not enable every drive")

    def _measured(self) -> Iterator[str]:
        axes, cells = self._image.axes, self._image.cells
        finite = np.isfinite(axes["angle"]).all() and np.isfinite(axes["torque"]).all()
        if not (finite and np.isfinite(cells["force"]).all()):
            yield "a measurement is not finite"
        fresh = self._config.control.freshness.measurement_ticks
        for what, ages in zip(("axis", "cell"), self._ages, strict=True):
            for number in np.flatnonzero(ages > fresh):
                yield f"{what} {number} has no fresh measurement within {SETTLE_TICKS} ticks"
            for number in np.flatnonzero((ages > 0) & (ages <= fresh)):
                yield f"{what} {number} is read {ages[number]} ticks late"
        for axis in np.flatnonzero(axes["state"] == AxisState.LOST):
            yield f"axis {axis} is LOST"

    def _all_enabled(self) -> bool:
        return bool((self._image.axes["state"] == AxisState.OPERATION_ENABLED).all())

    async def _objects(self, bus: Fieldbus) -> None:
        for axis in range(self._config.robot.cables):
            word = await bus.sdo_read(axis, _STATUSWORD, 0)
            self._must(len(word) == 2, f"sdo_read of axis {axis}: 0x6041 has {len(word)} bytes")
        try:
            await bus.sdo_read(0, _NO_OBJECT, 0)
        except DriverError:
            return
        except Exception as error:  # noqa: BLE001  # a violation, whatever it is
            self._must(False, f"sdo_read raises {type(error).__name__}, which is no DriverError")
            return
        self._must(False, "sdo_read of an object that is not there raises no DriverError")

    async def _without_torque(self, bus: Fieldbus, lab: Lab) -> None:
        """A torque that is not finite, on drives that are enabled."""
        self._image.commands["torque"] = 0.01
        await self._ticks(bus, SETTLE_TICKS)
        moved = [drive.axis for drive in lab.drives if not drive.objects.number(_TARGET_TORQUE, 0)]
        self._must(not moved, f"a torque does not reach the drives of axes {moved}")
        self._image.commands["torque"] = np.nan
        await self._ticks(bus, SETTLE_TICKS)
        given = [drive.axis for drive in lab.drives if drive.objects.number(_TARGET_TORQUE, 0)]
        self._must(not given, f"a torque that is not finite is not 0 at axes {given}")
        self._image.commands["torque"] = 0.0
        await self._ticks(bus, SETTLE_TICKS)
