"""What the daemon hears of the supervisor: its heartbeat on each channel, and why it stopped."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from tonus.config.schema.supervisor import REQUIREMENT_TEXTS, Requirement, Supervisor
from tonus.drivers.canopen.channel import Channel
from tonus.drivers.canopen.identifiers import EMCY, HEARTBEAT
from tonus.drivers.canopen.nmt import NmtState
from tonus.drivers.errors import BringUpError
from tonus.drivers.events import EventLog
from tonus.drivers.process_image import AxisState, ProcessImage

EMERGENCY = struct.Struct("<HBBf")
"""Error code 0xFF00 plus the requirement's number, error register, axis or cell from 0 (0xFF:
none), and what was found, in the unit of the requirement."""
ERROR_CODE = 0xFF00
NOWHERE = 0xFF
_OPERATIONAL = bytes([NmtState.OPERATIONAL])


@dataclass
class _Heard:
    channel: str
    axes: list[int]
    """of the drives that are to stop without it"""
    obeyed_ticks: int
    """from its last heartbeat until they have, at the latest"""
    tick: int = 0
    fresh: bool = False
    beating: bool = False
    lost: bool = False
    """it has been beating before"""
    holds: bool = False
    """its last heartbeat followed another in time: a single one only begins a watch, and ends it"""
    held_at: int | None = None
    """tick of the last one that did"""
    obeyed: bool = False
    """there was a moment since then in which none of the drives was enabled"""
    told: bool = False
    """that it has not begun though drives are enabled"""
    anybody: bool = False
    """sent a heartbeat of its number, in whatever state"""


class SupervisorMonitor:
    """Events, and an obstacle to arming where the policy requires a supervisor."""

    def __init__(
        self,
        settings: Supervisor | None,
        period_us: int,
        image: ProcessImage,
        events: EventLog,
    ) -> None:
        self._settings = settings if settings is None or settings.policy != "off" else None
        self._image, self._events = image, events
        self._patience = 0
        if self._settings is not None:
            self._patience = self._settings.timeout_ms * 1000 // period_us
        self._heard: list[_Heard] = []
        self._out_of_reach: list[str] = []
        self._stopped = False
        """it has said that it stopped the robot, and not begun again"""
        self.ignored = False
        """its heartbeat has ended, and drives that were to stop by themselves have not"""
        self.doubt = False
        """a reset has to bring devices up again: another master may have written to them, or they
        did not stop by themselves"""

    def cannot_stop(self, where: str) -> None:
        """A drive that does not wait for its heartbeat."""
        self._out_of_reach.append(where)

    def listen(
        self, channel: Channel, axes: Sequence[int], obeyed_ticks: int | None = None
    ) -> None:
        """``axes``: of the drives that are to stop by themselves when its heartbeat on this channel
        ends, within ``obeyed_ticks``; without that, twice as long as they wait for it."""
        if self._settings is None:
            return
        obeyed_ticks = 2 * self._patience if obeyed_ticks is None else obeyed_ticks
        heard = _Heard(channel.name, list(axes), obeyed_ticks)
        self._heard.append(heard)
        channel.handlers[HEARTBEAT + self._settings.node_id] = lambda data: self._on_heartbeat(
            heard, data
        )
        channel.handlers[EMCY + self._settings.node_id] = lambda data: self._on_emergency(
            heard, data
        )

    async def foreign(self) -> list[str]:
        """Channels on which another device sends heartbeats of its node number, often enough to
        hold drives that the supervisor's silence is to stop. Call it while no device has been
        started: the supervisor has not begun then, and one that has been going falls silent."""
        settings = self._settings
        if settings is None or not any(heard.anybody for heard in self._heard):
            return []
        await asyncio.sleep(settings.quiet_s)
        for heard in self._heard:
            heard.anybody = False
        await asyncio.sleep(2 * settings.timeout_ms * 1e-3)
        return [heard.channel for heard in self._heard if heard.anybody]

    async def refuse_foreign(self) -> None:
        """Raises `BringUpError` where another device is `foreign`."""
        foreign = await self.foreign()
        if foreign:
            raise BringUpError(
                f"bring-up failed: another device on {', '.join(foreign)} sends heartbeats of the "
                "supervisor's node number, so that its silence would stop no drive; give the "
                "device another number, or set supervisor.node_id"
            )

    def forget(self) -> None:
        self._image.obstacles.pop(self._item, None)
        self._heard, self._out_of_reach = [], []
        self.doubt = self.ignored = False

    @property
    def beating(self) -> bool:
        """On each channel."""
        return all(heard.beating for heard in self._heard)

    def silence(self, tick: int) -> int:
        """Ticks since its last heartbeat, where it has been silent for longest; 0 before the first,
        with which a watch begins."""
        return max((tick - heard.tick for heard in self._heard if heard.tick), default=0)

    @property
    def _item(self) -> str:
        """Of its own: a robot may have several fieldbuses on CAN."""
        return "supervisor of " + ", ".join(heard.channel for heard in self._heard)

    def look(self, tick: int) -> None:
        """Once a tick."""
        silent = []
        for heard in self._heard:
            if heard.fresh:
                heard.fresh = False
                heard.tick = tick
                if heard.holds:
                    heard.holds, heard.held_at, heard.obeyed = False, tick, False
            elif heard.beating and tick - heard.tick > self._patience:
                heard.beating, heard.lost = False, True
                text = f"no heartbeat for more than {self._patience} ticks"
                self._events.begin("supervisor_lost", heard.channel, text)
            elif not (heard.beating or heard.lost or heard.told) and self._image.enabling:
                heard.told = True
                text = "the drives are enabled, and the supervisor has not begun"
                self._events.begin("unsupervised", heard.channel, text)
            # A single heartbeat begins a watch, and holds nothing.
            if heard.held_at is None or tick - heard.held_at > self._patience:
                silent.append(heard)
        self.ignored = any(self._is_ignored(heard, tick) for heard in silent)
        self.doubt |= self.ignored
        obstacle = self._obstacle([heard.channel for heard in silent])
        if obstacle:
            self._image.obstacles[self._item] = obstacle
        elif self._image.obstacles:
            self._image.obstacles.pop(self._item, None)

    def _is_ignored(self, heard: _Heard, tick: int) -> bool:
        """Of one whose heartbeats do not follow each other in time: a drive says that it is
        enabled, later than it may be. Those that are enabled after a loss, where the policy allows
        it, wait for nobody: their watch has not begun."""
        if heard.held_at is None:
            return False
        axis = self._image.axis
        enabled = axis.state[heard.axes] == AxisState.OPERATION_ENABLED
        heard.obeyed |= not (self._required or enabled.any())
        late = axis.age[heard.axes] < tick - heard.held_at - heard.obeyed_ticks
        return not heard.obeyed and bool((enabled & late).any())

    @property
    def _required(self) -> bool:
        return self._settings is not None and self._settings.policy == "require"

    def _obstacle(self, silent: list[str]) -> str:
        """To arming; "" for none. ``silent``: channels that are not held."""
        if self.doubt:
            return (
                "a device did not stop without its heartbeat, or another master may have written "
                "to one: emergency stop, then reset"
            )
        if not self._required:
            return ""
        if self._out_of_reach:
            drives = ", ".join(self._out_of_reach)
            return f"cannot stop {drives}: no second heartbeat consumer"
        if not silent:
            return ""
        remedy = "; it has stopped the robot: emergency stop, then reset" if self._stopped else ""
        return f"is not heard on {', '.join(silent)}{remedy}"

    def _on_heartbeat(self, heard: _Heard, data: bytes) -> None:
        heard.anybody = True
        if data != _OPERATIONAL:
            return
        follows = heard.beating  # another one in time: a single one begins nothing
        self._stopped &= not follows
        heard.holds |= follows
        heard.fresh = heard.beating = True
        heard.lost = False
        self._events.end("unsupervised", heard.channel)
        if follows and self._events.end("supervisor_lost", heard.channel):
            self._events.counted("supervisor_back", heard.channel, "heartbeat received again")

    def _on_emergency(self, heard: _Heard, data: bytes) -> None:
        if len(data) != EMERGENCY.size:
            text = f"emergency of {len(data)} bytes"
            self._events.counted("short_emcy", f"{heard.channel}/supervisor", text)
            return
        code, _, place, value = EMERGENCY.unpack(data)
        number = code - ERROR_CODE
        self._stopped = True
        self.doubt |= number == Requirement.COMMANDED
        try:
            said = REQUIREMENT_TEXTS[Requirement(number)]
        except ValueError:
            said = "unknown here"
        where = "" if place == NOWHERE else f" at {place}"
        text = f"SUP-{number}{where}, {value:.4g}: broken is: {said}"
        self._events.counted("supervisor_stopped", heard.channel, text, kind=data)
