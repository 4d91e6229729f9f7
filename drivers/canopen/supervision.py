"""What nodes say of themselves while the robot runs: heartbeats, boot-ups, emergencies."""

from __future__ import annotations

from dataclasses import dataclass, field

from tonus.config.schema.bus import Master
from tonus.config.schema.tolerance import Tolerance
from tonus.config.timeouts import node_timeout_ms
from tonus.drivers.canopen import emcy
from tonus.drivers.canopen.identifiers import EMCY, HEARTBEAT
from tonus.drivers.canopen.nmt import NmtState
from tonus.drivers.canopen.node import Node
from tonus.drivers.canopen.syncs import Arrival
from tonus.drivers.devices.drive_errors import Reset
from tonus.drivers.events import EventLog
from tonus.drivers.exchange import Exchange

_RESETS = (Reset.COMMUNICATION_RESET, Reset.DEVICE_RESET)


@dataclass
class Watched:
    """A node, its rows in the process image, and what was heard of it."""

    node: Node
    arrival: Arrival
    axis: int | None = None
    cells: tuple[int, ...] = ()
    heard_at: int = 0
    """tick"""
    silent: bool = False
    restarted: bool = False
    """of itself: its configuration is gone"""
    standing: set[Reset] = field(default_factory=set)
    """what its errors need beyond a fault reset"""

    @property
    def trusted(self) -> bool:
        operational = self.node.monitor.state is NmtState.OPERATIONAL
        return self.node.started and operational and not (self.silent or self.restarted)


class Supervision:
    """Turns those frames into events, and into what control must know of an axis or a cell."""

    def __init__(
        self,
        exchange: Exchange,
        events: EventLog,
        master: Master,
        tolerance: Tolerance,
        period_us: int,
    ) -> None:
        self.watched: list[Watched] = []
        self._allowed_ms: list[int] = []
        """of each, between two heartbeats"""
        self._exchange = exchange
        self._events = events
        self._master, self._tolerance = master, tolerance
        self._period_us = period_us
        self._late_ticks = master.late_ticks
        self._next = 0
        self._tick = 0

    def add(self, watched: Watched) -> None:
        self.watched.append(watched)
        node = watched.node
        device = node.role.device
        self._allowed_ms.append(node_timeout_ms(device, self._master, self._tolerance))
        handlers = node.channel.handlers
        handlers[HEARTBEAT + node.node_id] = lambda data: self._on_heartbeat(watched, data)
        handlers[EMCY + node.node_id] = lambda data: self._on_emcy(watched, data)

    def clear(self) -> None:
        self.watched, self._allowed_ms = [], []

    def begin(self, tick: int) -> None:
        """Count silence from ``tick`` on."""
        self._tick = tick
        for watched in self.watched:
            watched.heard_at = tick

    def look_for_silence(self, tick: int) -> None:
        """One node a tick: a lost heartbeat is seen within as many ticks as there are nodes."""
        self._tick = tick
        if not self.watched:
            return
        self._next = (self._next + 1) % len(self.watched)
        watched = self.watched[self._next]
        node = watched.node
        self._look_for_answers(watched)
        if node.monitor.heard:
            node.monitor.heard = False
            watched.heard_at = tick
            return
        allowed_ms = self._allowed_ms[self._next]
        if (tick - watched.heard_at) * self._period_us > allowed_ms * 1000 and node.started:
            watched.silent = True
            self.trust(watched)
            text = f"{node.role.title}: no heartbeat for more than {allowed_ms} ms"
            self._events.begin("heartbeat_lost", node.where, text)

    def _look_for_answers(self, watched: Watched) -> None:
        node, unanswered = watched.node, watched.arrival.silence
        if unanswered <= self._late_ticks:
            self._events.end("silent_pdo", node.where)
        elif watched.trusted:
            text = f"{node.role.title}: no answer to {unanswered} SYNCs, its heartbeat is received"
            self._events.begin("silent_pdo", node.where, text)

    def trust(self, watched: Watched) -> None:
        """Tell control whether an axis may be believed; a cell's measurements age by themselves."""
        if watched.axis is not None:
            self._exchange.untrusted[watched.axis] = not watched.trusted

    def resetting(self, watched: Watched) -> None:
        """The node is about to be reset: what it reports from now on is of after that."""
        for cell in watched.cells:
            self._exchange.cell_emergency[cell] = 0
        self.trust(watched)

    def restored(self, watched: Watched) -> None:
        """The node was reset and is operational again."""
        watched.silent = watched.restarted = False
        watched.standing.clear()
        watched.heard_at = self._tick
        self._events.end("heartbeat_lost", watched.node.where)
        for cell in watched.cells:
            self._exchange.cell_status[cell] = 0
        self.trust(watched)

    def _on_heartbeat(self, watched: Watched, data: bytes) -> None:
        node = watched.node
        before = node.monitor.state
        state = node.monitor.receive(data)
        if state is None or not node.started:
            return
        title = node.role.title
        watched.silent = False
        if self._events.end("heartbeat_lost", node.where):
            self._events.counted("heartbeat_back", node.where, f"{title}: heartbeat received again")
        if state is NmtState.BOOT_UP:
            watched.restarted = True
            if watched.axis is not None:
                self._exchange.error_codes[watched.axis] = 0
            text = f"{title} restarted and lost its configuration"
            self._events.counted("boot_up", node.where, text)
        elif state is not before and state is not NmtState.OPERATIONAL:
            self._events.counted("left_operational", node.where, f"{title} is {state.words}")
        elif state is not before and not watched.restarted:
            text = f"{title} is operational, configured as it was"
            self._events.counted("operational_again", node.where, text)
        self.trust(watched)

    def _on_emcy(self, watched: Watched, data: bytes) -> None:
        node = watched.node
        parsed = emcy.parse(data)
        if parsed is None:
            self._events.counted("short_emcy", node.where, f"emergency of {len(data)} bytes")
            return
        code, register = parsed
        if watched.axis is not None:
            self._exchange.error_codes[watched.axis] = code
            needed = node.role.errors.reset(code)
            if not code:
                watched.standing.clear()
            elif needed in _RESETS:
                watched.standing.add(needed)
        for cell in watched.cells:
            self._exchange.cell_emergency[cell] = code
        title = node.role.title
        meaning = node.role.errors.text(code)
        text = f"{title}: 0x{code:04X}, register 0x{register:02X}: {meaning}"
        self._events.counted("emcy", node.where, text, kind=code)
