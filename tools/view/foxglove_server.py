"""The running daemon for Foxglove, Lichtblick and PlotJuggler: its topics over their WebSocket.

The schemas and the bytes of the messages are those of the log, made by the same encoders; topics of
every tick are thinned. Reading needs no right: those programs are pages from elsewhere. The one
service commands the daemon, and wants the viewer's token.
"""

from __future__ import annotations

import hmac
import json
import threading
from pathlib import Path

import foxglove
import numpy as np
from foxglove.websocket import (
    Capability,
    MessageSchema,
    Service,
    ServiceRequest,
    ServiceSchema,
)

from tonus.config.schema.root import Config
from tonus.runtime.operation.verbs import VERBS
from tonus.runtime.recording.mcap_file import CDR_HEADER, Block
from tonus.runtime.recording.messages import Encoder, EventEncoder, encoder
from tonus.runtime.recording.ring import RingError, RingReader
from tonus.runtime.recording.segment import CYCLE_RING, cycle_dtype
from tonus.runtime.recording.viewer import Scene, ViewerEncoder
from tonus.runtime.timing import clock
from tonus.tools.control_client import ControlClient
from tonus.tools.errors import ToolError
from tonus.tools.view.live import Live
from tonus.tools.view.operate import FIELDS
from tonus.tools.view.settings import settings

SERVICE = "/tonus/command"
_AT_ONCE = 4000
_BACKLOG = 4096
"""messages that may wait for a client; then the oldest go"""
_RINGS = (CYCLE_RING, "truth.ring", "events.ring")
"""frames and keyframes stay in the log: they are too many, or of no use to a viewer"""
_REQUEST = {
    "type": "object",
    "properties": {
        "verb": {"type": "string", "enum": list(VERBS)},
        "name": {"type": "string", "description": "of a scenario"},
        "key": {"type": "string", "description": "of a parameter to set"},
        "value": {"type": "number", "description": "to set it to"},
        "token": {"type": "string", "description": "that tonus view --operate printed"},
    },
}


class _Topics:
    """Announces topics to those who connect, as a file would hold them."""

    def __init__(self, context: foxglove.Context) -> None:
        self._context = context
        self.channels: list[foxglove.Channel] = []

    def channel(self, topic: str, message: str, definition: str) -> int:
        schema = foxglove.Schema(name=message, encoding="ros2msg", data=definition.encode())
        self.channels.append(
            foxglove.Channel(topic, schema=schema, message_encoding="cdr", context=self._context)
        )
        return len(self.channels) - 1

    def send(self, block: Block) -> None:
        channel = self.channels[block.channel]
        if not channel.has_sinks():
            return
        for stamp, body in zip(block.log_time.tolist(), block.body, strict=True):
            channel.log(CDR_HEADER + body.tobytes(), log_time=stamp)


class _Ring:
    """One ring, thinned where it has a record for every tick."""

    def __init__(self, path: Path, topics: _Topics, events: EventEncoder, config: Config) -> None:
        self.reader = RingReader.look(path)
        self._encode: Encoder = encoder(topics, events, self.reader.meta)
        self._viewer: ViewerEncoder | None = None
        period = config.control.rates.period
        self._step = max(1, round(1.0 / (settings().foxglove_hz * period)))
        if path.name == CYCLE_RING:
            self._dtype = cycle_dtype(self.reader.meta)
            scene = Scene.of(config)
            if scene is not None:
                self._viewer = ViewerEncoder(topics, scene)
        elif self.reader.meta["kind"] == "events":
            self._step = 1

    def blocks(self, utc_offset_ns: int) -> list[Block]:
        """What is new, as messages."""
        stamps, payload = self.reader.drain(_AT_ONCE)
        positions, times = self.reader.positions, stamps + utc_offset_ns
        some = positions % self._step == 0
        found: list[Block] = []
        if some.any():
            found = self._encode(times[some], positions[some], np.ascontiguousarray(payload[some]))
        if self._viewer is not None and len(payload):
            found += self._viewer(times, np.ascontiguousarray(payload).view(self._dtype)[:, 0])
        return found


class FoxgloveServer:
    """Serves a live run until `close`. Raises `ToolError` when the port cannot be had."""

    def __init__(
        self, live: Live, host: str, port: int, *, operate: bool, token: str | None
    ) -> None:
        self._socket = live.description.socket
        self._token = token if operate else None
        self._context = foxglove.Context()
        self._topics = _Topics(self._context)
        events = EventEncoder(self._topics)
        try:
            self._rings = [
                _Ring(live.rings / name, self._topics, events, live.config)
                for name in _RINGS
                if (live.rings / name).exists()
            ]
        except (RingError, OSError) as error:
            raise ToolError(f"the run of {live.rings} is gone: {error}") from error
        self._offset_ns = 0 if live.description.virtual else clock.utc_offset_ns()
        try:
            self._server = foxglove.start_server(
                name="Tonus",
                host=host,
                port=port,
                capabilities=[Capability.Services],
                services=[self._service()],
                supported_encodings=["json"],
                context=self._context,
                message_backlog_size=_BACKLOG,
            )
        except (OSError, RuntimeError) as error:
            raise ToolError(
                f"{host} port {port}: {error}; choose another with --foxglove PORT"
            ) from error
        self.port = self._server.port
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._send, name="foxglove", daemon=True)
        self._thread.start()

    def _send(self) -> None:
        while not self._over.wait(1.0 / settings().rate_hz):
            for ring in self._rings:
                for block in ring.blocks(self._offset_ns):
                    self._topics.send(block)

    def _service(self) -> Service:
        schema = MessageSchema(
            encoding="json",
            schema=foxglove.Schema(
                name="tonus.Command", encoding="jsonschema", data=json.dumps(_REQUEST).encode()
            ),
        )
        return Service(
            SERVICE, schema=ServiceSchema("tonus.Command", request=schema), handler=self._command
        )

    def _command(self, request: ServiceRequest) -> bytes:
        return json.dumps(self._answer(request.payload)).encode()

    def _answer(self, payload: bytes) -> dict[str, object]:
        """The daemon's reply, or why it was not asked."""
        try:
            asked = json.loads(payload)
        except (ValueError, RecursionError):
            asked = None
        if not isinstance(asked, dict):
            return _refusal("a request is one JSON object", "give verb and token")
        if self._token is None or self._socket is None:
            return _refusal("this viewer only shows", "start it with: tonus view --operate")
        given = str(asked.get("token", ""))
        if not hmac.compare_digest(given.encode(), self._token.encode()):
            return _refusal("the token is missing or wrong", "give the one of the page's address")
        fields = {name: asked[name] for name in FIELDS if name in asked}
        try:
            with ControlClient(Path(self._socket)) as daemon:
                return daemon.ask(str(asked.get("verb")), **fields)
        except ToolError as error:
            return _refusal(str(error), "")

    def close(self) -> None:
        """End server and thread."""
        self._over.set()
        self._thread.join()
        self._server.stop()
        for ring in self._rings:
            ring.reader.close()


def _refusal(error: str, remedy: str) -> dict[str, object]:
    return {"ok": False, "error": error, "next": remedy}
