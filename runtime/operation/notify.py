"""What the service manager is told: ready, how it goes, still alive (sd_notify(3), without its
library: a datagram of KEY=VALUE lines to the address in $NOTIFY_SOCKET)."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from contextlib import suppress

from tonus.runtime.states import MEANING, State

_US_NS = 1000


class Notifier:
    """Does nothing where no service manager listens. Never waits: what cannot be sent is dropped,
    and the watchdog then does what it is for."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._socket: socket.socket | None = None
        self._address = "\0" + address[1:] if address.startswith("@") else address
        if address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
        ours = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        microseconds = int(environment.get("WATCHDOG_USEC", "0")) if ours else 0
        self._interval_ns = microseconds * _US_NS // 2
        self._next_ns: int | None = None
        self._state: State | None = None

    def ready(self) -> None:
        """The bus is up and ticks follow."""
        self._send("READY=1")

    def stopping(self) -> None:
        self._send("STOPPING=1\nSTATUS=ending")

    def beat(self, now_ns: int, state: State) -> None:
        """After each tick; sends something when the state changed or the watchdog wants it."""
        if self._socket is None:
            return
        if state is not self._state:
            self._state = state
            self._send(f"STATUS={state.name}: {MEANING[state]}")
        if self._interval_ns and (self._next_ns is None or now_ns >= self._next_ns):
            self._next_ns = now_ns + self._interval_ns
            self._send("WATCHDOG=1")

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()

    def _send(self, text: str) -> None:
        if self._socket is not None:
            with suppress(OSError):
                self._socket.sendto(text.encode(), self._address)
