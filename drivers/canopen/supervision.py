"""What nodes say of themselves while the robot runs: heartbeats, boot-ups, emergencies."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.canopen import emcy
from drivers.canopen.identifiers import EMCY, HEARTBEAT
from drivers.canopen.nmt import HEARTBEAT_PERIODS, NmtState
from drivers.canopen.node import Node
from drivers.events import EventLog
from drivers.exchange import Exchange

UNTRUSTED = 0xFF
"""Status of a force cell that raised an emergency and has not taken it back."""


@dataclass
class Watched:
    """A node, its row in the process image, and the tick in which it was last heard."""

    node: Node
    axis: int | None
    cell: int | None
    heard_at: int = 0


class Supervision:
    """Turns those frames into events, and into what control must know of an axis or a cell."""

    def __init__(self, exchange: Exchange, events: EventLog, period_us: int) -> None:
        self._exchange = exchange
        self._events = events
        self._period_us = period_us
        self._watched: list[Watched] = []
        self._next = 0
        self.running = False
        """during bring-up nodes restart because they are told to, which is no event"""

    def add(self, node: Node, axis: int | None = None, cell: int | None = None) -> None:
        watched = Watched(node, axis, cell)
        self._watched.append(watched)
        handlers = node.channel.handlers
        handlers[HEARTBEAT + node.node_id] = lambda data: self._on_heartbeat(watched, data)
        handlers[EMCY + node.node_id] = lambda data: self._on_emcy(watched, data)

    def clear(self) -> None:
        self.running = False
        self._watched = []

    def begin(self, tick: int) -> None:
        """Count silence from ``tick`` on."""
        for watched in self._watched:
            watched.heard_at = tick

    def look_for_silence(self, tick: int) -> None:
        """One node a tick: a lost heartbeat is seen within as many ticks as there are nodes."""
        if not self._watched:
            return
        self._next = (self._next + 1) % len(self._watched)
        watched = self._watched[self._next]
        node = watched.node
        if node.monitor.heard:
            node.monitor.heard = False
            watched.heard_at = tick
            return
        allowed_ms = HEARTBEAT_PERIODS * node.role.device.heartbeat_ms
        if (tick - watched.heard_at) * self._period_us > allowed_ms * 1000:
            self._set_silent(watched, silent=True)
            text = f"{node.role.title}: no heartbeat for more than {allowed_ms} ms"
            self._events.begin("heartbeat_lost", node.where, text)

    def _set_silent(self, watched: Watched, *, silent: bool) -> None:
        if watched.axis is not None:
            self._exchange.silent[watched.axis] = silent

    def _on_heartbeat(self, watched: Watched, data: bytearray) -> None:
        node = watched.node
        before = node.monitor.state
        state = node.monitor.receive(data)
        if state is None or not self.running:
            return
        title = node.role.title
        if self._events.end("heartbeat_lost", node.where):
            self._set_silent(watched, silent=False)
            self._events.counted("heartbeat_back", node.where, f"{title} is heard again")
        if state is NmtState.BOOT_UP:
            text = f"{title} restarted and lost its configuration"
            self._events.counted("boot_up", node.where, text)
        elif state is not before and state is not NmtState.OPERATIONAL:
            text = f"{title} is {state.words}"
            self._events.counted("left_operational", node.where, text)

    def _on_emcy(self, watched: Watched, data: bytearray) -> None:
        node = watched.node
        parsed = emcy.parse(data)
        if parsed is None:
            self._events.counted("short_emcy", node.where, f"emergency of {len(data)} bytes")
            return
        code, register = parsed
        if watched.axis is not None:
            self._exchange.error_codes[watched.axis] = code
        if watched.cell is not None:
            self._exchange.cell_status[watched.cell] = UNTRUSTED if code else 0
        title = node.role.title
        text = f"{title}: 0x{code:04X} {emcy.words(code)}, register 0x{register:02X}"
        self._events.counted("emcy", node.where, text)
