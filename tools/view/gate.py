"""The viewer's server, and what stands before it: who may connect, from which page, how much and
how fast.

Page and scene, with a WebSocket each, are on one port. Everything that reaches them passes here
first: the Host header (so that no foreign name leads here), a token, the Origin of a WebSocket (so
that no page from elsewhere can command a robot on this host), bounds on connections, message size
and rate.
"""

from __future__ import annotations

import asyncio
import hmac
import http
import logging
import secrets
import socket
import threading
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosedError
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from tonus.runtime.timing import clock
from tonus.tools.errors import ToolError
from tonus.tools.view.client import client_file
from tonus.tools.view.settings import settings

Handler = Callable[[ServerConnection], Awaitable[None]]

SCENE, CHANNEL = "/scene", "/channel"
"""paths: of viser's client and WebSocket, and of the page's own WebSocket"""
_POLICY = 1008
_END_S = 1.0
"""for pages to say good-bye"""
_QUIET = logging.getLogger("tonus.view")
"""where websockets says of each stranger that it was refused: nobody reads it"""
_QUIET.setLevel(logging.CRITICAL)
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; img-src 'self' data:; frame-ancestors 'self'; base-uri 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "SAMEORIGIN",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


@dataclass(frozen=True)
class Page:
    """A file of the page."""

    kind: str
    content: bytes
    packed: bytes | None = None
    """with gzip, for those who reach this host by a network"""


class Bucket:
    """Messages that one connection may still send now."""

    def __init__(self, rate_hz: float, burst: int) -> None:
        self._rate, self._burst = rate_hz, float(burst)
        self._left, self._at = float(burst), clock.wall_seconds()

    def take(self) -> bool:
        """Whether there was one left."""
        now = clock.wall_seconds()
        self._left = min(self._left + (now - self._at) * self._rate, self._burst)
        self._at = now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class Gate:
    """Serves on ``host`` and ``port``; with a ``token`` to those only who know it.

    Raises `ToolError` when the address cannot be had.
    """

    def __init__(self, host: str, port: int | None, token: str | None) -> None:
        self._token = token
        self._listener = _listener(host, port)
        self.host, self.port = host, int(self._listener.getsockname()[1])
        self._cookie = f"tonus-{self.port}"
        self._open = 0
        self.pages: dict[str, Page] = {}
        self.channel: Handler | None = None
        """serves the page's own WebSocket"""
        self.scene: Handler | None = None
        """serves that of the scene"""
        self._scene_pages: dict[str, Page] = {}
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._started, self._stopping = threading.Event(), asyncio.Event()

    @property
    def address(self) -> str:
        """For a browser, with the token."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        query = f"?token={self._token}" if self._token else ""
        return f"http://{host}:{self.port}/{query}"

    def start(self) -> None:
        """Serve, in a thread of its own, until `stop`. Raises `ToolError` without a client for the
        scene."""
        content = client_file()
        packed = None
        if not is_local(self.host):
            import gzip  # a first picture on this host does not wait for it

            packed = gzip.compress(content)
        page = Page("text/html; charset=utf-8", content, packed)
        self._scene_pages = dict.fromkeys((SCENE, f"{SCENE}/index.html"), page)
        self._thread.start()
        self._started.wait()

    def stop(self) -> None:
        """Let every connection go."""
        if self._loop is not None and self._thread.is_alive():
            with suppress(RuntimeError):  # it has ended
                self._loop.call_soon_threadsafe(self._stopping.set)
            self._thread.join(_END_S)
        self._listener.close()

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        async with serve(
            self._admit,
            sock=self._listener,
            max_size=settings().message_bytes,
            max_queue=8,
            open_timeout=settings().handshake_s,
            close_timeout=_END_S,
            process_request=self.answer,
            create_connection=self._connection,  # type: ignore[arg-type]  # a factory will do
            select_subprotocol=_spoken,
            server_header=None,
            compression=None,  # it would cost the viewer more than it saves
            logger=_QUIET,
        ):
            self._started.set()
            await self._stopping.wait()

    def _connection(self, *given: Any, **options: Any) -> ServerConnection:
        return _Connection(self, *given, **options)

    async def _admit(self, connection: ServerConnection) -> None:
        handler = self.scene if _path(connection.request) == SCENE else self.channel
        if handler is not None:
            await handler(connection)

    def answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """What a request gets: a page, a refusal, or None for a WebSocket that may be opened."""
        del connection
        host = request.headers.get("Host", "")
        if not self._is_ours(host):
            return _refused(http.HTTPStatus.FORBIDDEN, "this host name is not served")
        known, fresh = self._knows(request)
        if not known:
            text = "a token is needed: open the address that tonus view has printed"
            return _refused(http.HTTPStatus.UNAUTHORIZED, text)
        path = _path(request)
        if request.headers.get("Upgrade", "").lower() == "websocket":
            if request.headers.get("Origin") != f"http://{host}":
                return _refused(http.HTTPStatus.FORBIDDEN, "this page is from elsewhere")
            if path not in (SCENE, CHANNEL):
                return _refused(http.HTTPStatus.NOT_FOUND, "not found")
            return None
        scene = self._scene_pages.get(path)
        if scene is not None:
            return _of_scene(scene, request)
        page = self.pages.get(path)
        if page is None:
            return _refused(http.HTTPStatus.NOT_FOUND, "not found")
        return _response(http.HTTPStatus.OK, page.kind, page.content, fresh)

    def _is_ours(self, host: str) -> bool:
        """Whether a Host header names this server: on the loopback by its usual names only, so
        that a foreign name which leads here is refused."""
        name, number = _split(host)
        if number != self.port:
            return False
        return name in _LOCAL or (not is_local(self.host) and bool(name))

    def _knows(self, request: Request) -> tuple[bool, Headers]:
        """Whether the token came, by address or cookie, and the headers that make it a cookie."""
        fresh = Headers()
        if self._token is None:
            return True, fresh
        given = parse_qs(urlsplit(request.path).query).get("token", [""])[0]
        if hmac.compare_digest(given.encode(), self._token.encode()):
            fresh["Set-Cookie"] = f"{self._cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/"
            return True, fresh
        for text in request.headers.get_all("Cookie"):
            try:
                morsel = SimpleCookie(text).get(self._cookie)
            except CookieError:
                continue
            if morsel and hmac.compare_digest(morsel.value.encode(), self._token.encode()):
                return True, fresh
        return False, fresh

    def enter(self) -> bool:
        """Count one connection more; False if there are too many."""
        self._open += 1
        return self._open <= settings().connections

    def leave(self) -> None:
        """One less."""
        self._open -= 1


class _Connection(ServerConnection):
    """One that is counted from its first byte on, and whose messages are bounded in rate."""

    def __init__(self, gate: Gate, *given: Any, **options: Any) -> None:
        super().__init__(*given, **options)
        self._gate = gate
        self._bucket = Bucket(settings().message_hz, settings().message_burst)

    def connection_made(self, transport: Any) -> None:
        if not self._gate.enter():
            transport.abort()
        super().connection_made(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        self._gate.leave()
        super().connection_lost(exc)

    async def recv(self, decode: bool | None = None) -> Any:
        while True:
            data = await super().recv(decode)
            if not self._bucket.take():
                await self._end("too many messages")
            return data

    async def _end(self, reason: str) -> None:
        await self.close(_POLICY, reason)
        raise ConnectionClosedError(None, None)


_LOCAL = ("127.0.0.1", "localhost", "::1")


def is_local(host: str) -> bool:
    """Whether an address is this host's own, which nobody else reaches."""
    return host in _LOCAL or host.startswith("127.")


def new_token() -> str:
    """One that nobody guesses."""
    return secrets.token_urlsafe(24)


def _listener(host: str, port: int | None) -> socket.socket:
    """On the port, or without one on the first of ten that is free."""
    first = settings().port if port is None else port
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    problem = ""
    for number in range(first, first + (11 if port is None else 1)):
        listener = socket.socket(family, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, number))
        except OSError as error:
            listener.close()
            problem = f"{host} port {number}: {error.strerror or error}"
        else:
            return listener
    raise ToolError(f"{problem}; choose another with --host or --port")


def _spoken(connection: ServerConnection, offered: Sequence[Subprotocol]) -> Subprotocol | None:
    """That of a scene's client, whichever it is; the scene says which it does not speak."""
    del connection
    return next((each for each in offered if each.startswith("viser-v")), None)


def _of_scene(page: Page, request: Request) -> Response:
    """viser's client has its scripts within itself, and makes more of them."""
    headers = Headers({"X-Frame-Options": "SAMEORIGIN", "X-Content-Type-Options": "nosniff"})
    content = page.content
    if page.packed is not None and "gzip" in request.headers.get("Accept-Encoding", ""):
        headers["Content-Encoding"] = "gzip"
        content = page.packed
    headers["Content-Type"] = page.kind
    headers["Content-Length"] = str(len(content))
    headers["Connection"] = "close"
    status = http.HTTPStatus.OK
    return Response(status, status.phrase, headers, content)


def _path(request: Request | None) -> str:
    path = "/" if request is None else urlsplit(request.path).path
    return path.rstrip("/") or "/"


def _split(host: str) -> tuple[str, int]:
    try:
        parts = urlsplit(f"//{host}")
        return parts.hostname or "", parts.port or 80
    except ValueError:
        return "", 0


def _refused(status: http.HTTPStatus, text: str) -> Response:
    return _response(status, "text/plain; charset=utf-8", f"{text}\n".encode(), Headers())


def _response(status: http.HTTPStatus, kind: str, content: bytes, extra: Headers) -> Response:
    headers = Headers(_HEADERS)
    headers["Content-Type"] = kind
    headers["Content-Length"] = str(len(content))
    headers["Connection"] = "close"
    headers.update(extra)
    return Response(status, status.phrase, headers, content)
