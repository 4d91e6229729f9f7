"""The pages that are open: what each gets, and what it asks for.

Everything goes as JSON and is shown as text. A page that does not read is closed and not waited
for; it opens its connection anew and then gets what it missed.
"""

from __future__ import annotations

import asyncio
import json
import math
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from tonus.tools.view.settings import settings

Message = dict[str, Any]

_WAITING = 64
"""messages that may wait for a page"""
_POLICY = 1008
_LATER = 1013


class Client:
    """One page."""

    def __init__(self, number: int, connection: ServerConnection) -> None:
        self.number, self.connection = number, connection
        self.chosen: list[str] = []
        """signals that it wants beside the fixed plots"""
        self.fresh = True
        """has not been told anything yet"""
        self.since = -math.inf
        """s up to which it has the points of its plots"""
        self._waiting: asyncio.Queue[str] = asyncio.Queue(_WAITING)

    def put(self, text: str) -> None:
        """In the server's loop: send as soon as the page reads; too slow a page is closed."""
        try:
            self._waiting.put_nowait(text)
        except asyncio.QueueFull:
            transport = self.connection.transport
            transport.abort()

    async def send(self) -> None:
        """Until the connection ends."""
        while True:
            await self.connection.send(await self._waiting.get())


Asked = Callable[[Client, Message], None]


class Hub:
    """Serves the page's WebSocket in the server's loop; the viewer's own thread talks to it."""

    def __init__(self, asked: Asked, left: Callable[[Client], None]) -> None:
        """``asked``: called in the server's loop with each message of a page; ``left``: when one
        is gone."""
        self._asked, self._left = asked, left
        self._loop: asyncio.AbstractEventLoop | None = None
        self._clients: dict[int, Client] = {}
        self._number = 0
        self._lock = threading.Lock()

    @property
    def clients(self) -> list[Client]:
        """Every open page."""
        with self._lock:
            return list(self._clients.values())

    async def serve(self, connection: ServerConnection) -> None:
        """One page, to its end."""
        self._loop = asyncio.get_running_loop()
        with self._lock:
            full = len(self._clients) >= settings().clients
            self._number += 1
            client = Client(self._number, connection)
            if not full:
                self._clients[client.number] = client
        if full:
            await connection.close(_LATER, "too many pages are open")
            return
        sending = asyncio.create_task(client.send())
        try:
            async for data in connection:
                try:
                    message = json.loads(data)
                except (ValueError, RecursionError):
                    message = None
                if not isinstance(message, dict):
                    await connection.close(_POLICY, "not a message of this page")
                    break
                self._asked(client, message)
        except ConnectionClosed:
            pass
        finally:
            sending.cancel()
            with suppress(asyncio.CancelledError, ConnectionClosed):
                await sending
            with self._lock:
                self._clients.pop(client.number, None)
            self._left(client)

    def tell(self, clients: Iterable[Client], message: Message) -> None:
        """From any thread."""
        text = json.dumps(message, allow_nan=False)
        if self._loop is not None:
            for client in clients:
                self._loop.call_soon_threadsafe(client.put, text)
