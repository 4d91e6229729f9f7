"""Bringing slaves back while the robot stands and ticks go on."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from tonus.config.schema.bus import EthercatBus
from tonus.drivers.errors import DriverError
from tonus.drivers.ethercat.watch import Watch, Watched
from tonus.drivers.ethercat.wire import Wire
from tonus.drivers.events import EventLog
from tonus.drivers.exchange import Exchange

_AGAIN_S = 3e-3
"""Between two attempts at one slave."""


class Recovery:
    """Slaves that lost everything are configured anew, and with them all clocks are set; then every
    slave that is not in OP goes there."""

    def __init__(
        self,
        bus: EthercatBus,
        watch: Watch,
        exchange: Exchange,
        events: EventLog,
        set_clocks: Callable[[Wire], Awaitable[None]],
        look: Callable[[], None],
    ) -> None:
        """``set_clocks`` of all slaves may raise `DriverError`; ``look`` has the next tick ask for
        every slave's state."""
        self._bus = bus
        self._watch = watch
        self._exchange = exchange
        self._events = events
        self._set_clocks = set_clocks
        self._look = look

    async def __call__(self, wire: Wire) -> None:
        """What cannot be brought back is an event and stays lost."""
        waiting = [watched for watched in self._watch.watched if watched.left]
        anew = [watched for watched in waiting if watched.lost_everything]
        for watched in self._watch.watched:
            self._watch.forgive(watched)
        for watched in anew:
            slave = watched.slave
            watched.busy = True
            try:
                await wire.reconfigure(slave.number)
                await slave.configure(wire.objects(slave.number), self._exchange)
                await wire.remap(slave.number)
            except DriverError as error:
                waiting.remove(watched)
                self._give_up(watched, error)
        if any(watched in waiting for watched in anew):
            try:
                await self._set_clocks(wire)
            except DriverError as error:
                self._events.add("recovery_failed", self._bus.interface, f"clocks: {error}")
        for watched in anew:
            watched.busy = False
        for watched in waiting:
            if watched.left:  # it may have come back meanwhile
                await self._bring_back(watched, wire)

    async def _bring_back(self, watched: Watched, wire: Wire) -> None:
        why = watched.left
        loop = asyncio.get_running_loop()
        end = loop.time() + self._bus.master.state_timeout_ms * 1e-3
        while watched.left:
            if loop.time() >= end:
                self._give_up(watched, f"stays in {watched.status or 'silence'}")
                return
            self._watch.bring_back(watched, wire)
            self._look()
            await asyncio.sleep(_AGAIN_S)
        slave = watched.slave
        self._events.add("recovered", slave.where, f"{slave.title} ({why}) is in OP again")

    def _give_up(self, watched: Watched, why: object) -> None:
        slave = watched.slave
        self._events.add("recovery_failed", slave.where, f"{slave.title}: {why}")
