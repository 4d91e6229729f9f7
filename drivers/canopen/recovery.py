"""Bringing nodes back while the robot stands and ticks go on."""

from __future__ import annotations

import asyncio

from tonus.drivers.canopen.nmt import Command
from tonus.drivers.canopen.supervision import Supervision, Watched
from tonus.drivers.canopen.supervisor_monitor import SupervisorMonitor
from tonus.drivers.devices.cia402 import decode
from tonus.drivers.devices.drive_errors import RESETS, Reset
from tonus.drivers.errors import DriverError
from tonus.drivers.events import EventLog
from tonus.drivers.exchange import Exchange
from tonus.drivers.process_image import AxisState

_IN_FAULT = (AxisState.FAULT, AxisState.FAULT_REACTION_ACTIVE)


class Recovery:
    """Resets and configures every node that needs more than a controlword, all at once.

    Some errors (of an EPOS4 0x8120 and 0x8130) keep a fault reset from working until NMT reset
    communication, which loses the PDO mapping and the heartbeats: such a node goes the whole way of
    a bring-up again. So does every node that another master may have written to, from its reset of
    all objects on, and every amplifier that has reported an error and not taken it back: after that
    reset it reports anew what lasts.
    """

    def __init__(
        self,
        supervision: Supervision,
        supervisor: SupervisorMonitor,
        exchange: Exchange,
        events: EventLog,
    ) -> None:
        self._supervision, self._supervisor = supervision, supervisor
        self._exchange = exchange
        self._events = events

    async def __call__(self) -> None:
        """What cannot be brought back is an event and stays lost."""
        doubt, self._supervisor.doubt = self._supervisor.doubt, False
        nodes = (self._bring_back(each, doubt=doubt) for each in self._supervision.watched)
        restored = False
        try:
            restored = all(await asyncio.gather(*nodes))
        finally:  # an emergency stop cancels it
            self._supervisor.doubt |= doubt and not restored

    async def _bring_back(self, watched: Watched, *, doubt: bool) -> bool:
        """Returns whether it is as the bring-up makes it."""
        node, title = watched.node, watched.node.role.title
        try:
            reason = await self._reason(watched, doubt=doubt)
            if not reason:
                return True
            node.started = False
            device = doubt or Reset.DEVICE_RESET in watched.standing or bool(self._error(watched))
            self._supervision.resetting(watched)
            await node.configure(
                lambda _: None,
                Command.RESET_NODE if device else Command.RESET_COMMUNICATION,
            )
            watched.arrival.begin()
            await node.start()
        except DriverError as error:
            self._events.add("recovery_failed", node.where, f"{title}: {error}")
            return False
        self._supervision.restored(watched)
        self._events.add("recovered", node.where, f"{title} ({reason}) is operational again")
        return True

    async def _reason(self, watched: Watched, *, doubt: bool) -> str:
        """Why a node needs to be brought back; "" if it does not. Raises `SdoError`."""
        node = watched.node
        if watched.restarted:
            return "restarted"
        if watched.silent:
            return "silent"
        if not watched.trusted:
            return "not operational"
        if doubt:
            return "another master may have written to it"
        error = self._error(watched)
        if error:
            return f"error 0x{error:04X}, not taken back"
        if watched.axis is None:
            return ""
        if decode(self._exchange.statuswords[watched.axis]) in _IN_FAULT:
            needed = node.role.errors.reset(await node.error_code())
            if needed in (Reset.COMMUNICATION_RESET, Reset.DEVICE_RESET):
                watched.standing.add(needed)
        return next((f"an error that {RESETS[each]}" for each in watched.standing), "")

    def _error(self, watched: Watched) -> int:
        """That the amplifier of a node's cells has reported and not taken back; 0 for none."""
        return max((int(self._exchange.cell_emergency[each]) for each in watched.cells), default=0)
