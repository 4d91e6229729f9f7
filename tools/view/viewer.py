"""One viewer: takes moments from a live run or from logs, and shows them to every page."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tonus.config.errors import ConfigError
from tonus.runtime.states import State
from tonus.runtime.timing import clock
from tonus.tools.control_client import ControlClient
from tonus.tools.errors import ToolError
from tonus.tools.view import colours
from tonus.tools.view.gate import Gate
from tonus.tools.view.hub import Client, Hub, Message
from tonus.tools.view.live import Live, newest_run
from tonus.tools.view.moment import Moment, Source
from tonus.tools.view.operate import FIELDS, REFUSED, Operation, choices
from tonus.tools.view.page import files
from tonus.tools.view.scene import RobotScene
from tonus.tools.view.settings import held_against_its_schema, settings
from tonus.tools.view.signals import Plot, names_of, plots_of, series_of
from tonus.tools.view.stage import Stage
from tonus.tools.view.window import Window, points
from tonus.tools.view.words import happening, state_of

if TYPE_CHECKING:
    from tonus.config.schema.root import Config
    from tonus.tools.view.playback import Playback

_CHOSEN = 8
"""signals that one page may choose"""
_PATH_EVERY = 10
"""pictures between two looks at the path ahead"""
_LOOK_S = 0.5
_ALONE_S = 1.0
"""without a page to show a first picture to, after which the rest is loaded all the same"""


@dataclass(frozen=True)
class Panels:
    """What stands round the picture."""

    config: Config
    plots: tuple[Plot, ...]
    names: list[str]
    known: frozenset[str]

    @classmethod
    def of(cls, config: Config) -> Panels:
        names = names_of(config)
        return cls(config, plots_of(config), names, frozenset(names))


class Viewer:
    """Serves behind ``gate``; `run` is its main loop. Either ``live`` or a ``playback``."""

    def __init__(
        self,
        gate: Gate,
        live: Live | None,
        playback: Playback | None,
        *,
        operate: bool = False,
        follow: bool = True,
    ) -> None:
        """``follow``: after the end of a live run wait for the next one."""
        self._live, self._playback = live, playback
        self._operate, self._follow = operate, follow
        self._gate, self._stage = gate, Stage()
        self._built = 0
        """times: what one has shown is not the next one's"""
        self._hub = Hub(self._asked, self._left)
        self._ending = False
        self._stopping = threading.Event()
        """for the threads beside the main loop"""
        self._operation: Operation | None = None
        self._problem: ToolError | ConfigError | None = None
        self._build()
        gate.pages |= files()
        gate.channel, gate.scene = self._hub.serve, self._stage.serve
        gate.start()

    def _build(self) -> None:
        """Scene and windows of what is shown."""
        stage = self._stage
        stage.clear()
        self._built += 1
        sources: list[Source] = [self._live] if self._live else []
        if self._playback:
            sources += self._playback.logs
        self._scenes, self._windows = [], []
        for number, source in enumerate(sources):
            tint = colours.TINTS[(number - 1) % len(colours.TINTS)] if number else None
            name = f"/{self._built}/run{number + 1}"
            self._scenes.append(RobotScene(stage, source.shape, name=name, tint=tint))
            self._windows.append(Window())
        self._shape = sources[0].shape
        self._names = [source.name for source in sources]
        self._panels: Panels | None = None
        extent = float(np.abs(self._shape.frame).max())
        stage.look((1.7 * extent, -2.1 * extent, 1.0 * extent), at=(0.0, 0.0, 0.0))
        self._moments: list[Moment] = []
        self._events: deque[Message] = deque(maxlen=settings().events)
        self._read = 0
        """logs whose events have been told"""
        self._status: Message | None = None
        self._told_until = -np.inf
        self._pictures = 0
        self._loading = threading.Thread(target=self._load, args=(sources[0],), daemon=True)
        self._connect()

    def _load(self, source: Source) -> None:
        """All that takes longer than a first picture may wait for, while pictures go on."""
        try:
            held_against_its_schema()
            panels = Panels.of(source.config)
            if self._shape is source.shape:
                self._panels = panels
            rest = self._live or self._playback
            assert rest is not None
            rest.read_on()
        except (ToolError, ConfigError) as error:
            self._problem = error

    def _connect(self) -> None:
        """To the daemon's control socket, where there is one."""
        if self._operation is not None:
            self._operation.close()
            self._operation = None
        if self._live is None or self._live.description.socket is None:
            return
        socket = Path(self._live.description.socket)
        if self._operate:
            self._operation = Operation(socket)
        if self._operate or self._live.description.served:
            # Of a script's run the rings tell enough.
            asking = threading.Thread(
                target=self._ask_status, args=(self._live, socket), daemon=True
            )
            asking.start()

    def _ask_status(self, live: Live, socket: Path) -> None:
        """Again and again, while this run is shown."""
        while not self._stopping.is_set() and self._live is live and not live.is_over:
            try:
                with ControlClient(socket) as daemon:
                    while not self._stopping.is_set() and self._live is live:
                        reply = daemon.ask("status")
                        self._status = reply if reply["ok"] else None
                        self._stopping.wait(1.0 / settings().status_hz)
            except (ToolError, ValueError):
                self._status = None
                self._stopping.wait(_LOOK_S)

    # -- the main loop ---------------------------------------------------------------------------

    def run(self) -> None:
        """Until `close`, or the end of a live run that is not to be followed by another. Raises
        `ToolError` where the configuration turns out not to be of this version, `ConfigError` where
        the viewer's own cannot be taken."""
        period = 1.0 / settings().rate_hz
        due = last = clock.wall_seconds()
        plotted = -np.inf
        shown = False
        alone = settings().rate_hz * _ALONE_S
        while not self._ending:
            now = clock.wall_seconds()
            self._advance(now - last)
            last = now
            if self._problem is not None:
                raise self._problem
            if self._loading.ident is None and (shown or self._pictures > alone):
                self._loading.start()
            # One picture later than the first one, which is on its way to the page still.
            shown = bool(self._hub.clients) and all(len(each.newest) for each in self._moments)
            if now - plotted >= 1.0 / settings().plot_hz:
                plotted = now
                self._plot()
            if self._live is not None and self._live.is_over and not self._next_run():
                return
            due = max(due + period, clock.wall_seconds())
            clock.pause(max(due - clock.wall_seconds(), 0.0))

    def close(self) -> None:
        """From any thread, or a signal: without a lock, which the thread that a signal interrupts
        may hold."""
        self._ending = True

    def release(self) -> None:
        """Let go of everything, after `run`."""
        self._stopping.set()
        if self._operation is not None:
            self._operation.close()
        if self._loading.ident is not None:
            self._loading.join()
        for source in (self._live, self._playback):
            if source is not None:
                source.close()
        self._gate.stop()

    def _next_run(self) -> bool:
        """Wait for another daemon; False: end with this one."""
        ended = self._live
        assert ended is not None
        self._hub.tell(self._hub.clients, {"kind": "ended", "log": ended.description.log})
        if not self._follow:
            return False
        while not self._ending:
            clock.pause(_LOOK_S)
            try:
                live = Live(newest_run())
            except ToolError:
                continue
            self._live = live
            ended.close()
            self._build()
            for client in self._hub.clients:
                client.fresh = True
            break
        return True

    def _advance(self, elapsed_s: float) -> None:
        """One picture."""
        if self._playback is not None:
            self._moments = self._playback.advance(elapsed_s)
        elif self._live is not None:
            self._moments = [self._live.advance()]
        for scene, window, moment in zip(self._scenes, self._windows, self._moments, strict=True):
            window.add(moment.samples, jumped=moment.jumped)
            scene.show(moment.newest, moment.truth, moment.samples, jumped=moment.jumped)
        if any(moment.jumped for moment in self._moments):
            self._told_until = -np.inf
        if self._pictures % _PATH_EVERY == 0:
            self._show_ahead()
        self._pictures += 1
        self._find_events()
        clients = self._hub.clients
        for client in clients:
            if client.fresh and self._panels is not None:
                client.fresh = False
                client.since = -np.inf
                self._welcome(client, self._panels)
        self._hub.tell(clients, self._now())

    def _show_ahead(self) -> None:
        """A log tells where the reference goes; of a live run its scenario does."""
        if self._live is not None:
            self._scenes[0].show_ahead(self._live.ahead(settings().path_s))
            return
        assert self._playback is not None
        for number, scene in enumerate(self._scenes):
            ahead = self._playback.ahead(number, settings().path_s)
            scene.show_ahead(ahead.rows["pose"]["desired_position"])

    def _plot(self) -> None:
        """New points of every plot."""
        newest = max(window.newest_s for window in self._windows)
        panels = self._panels
        if panels is None:
            return
        for client in self._hub.clients:
            if client.fresh:
                continue
            since = min(client.since, self._told_until)
            client.since = newest
            chosen = [series for name in client.chosen if (series := series_of(name))]
            runs = [points(window.after(since), panels.plots, chosen) for window in self._windows]
            if any(run["t"] for run in runs):
                anew = since == -np.inf
                self._hub.tell([client], {"kind": "points", "runs": runs, "anew": anew})
        self._told_until = newest

    def _find_events(self) -> None:
        """Tell what is new."""
        new = [
            happening(run, each)
            for run, moment in enumerate(self._moments)
            for each in moment.happenings
        ]
        if self._playback is not None:
            found = self._playback.events()
            for run, happenings in found[self._read :]:
                new += [happening(run, each) for each in happenings]
            self._read = len(found)
        if new:
            self._events += new
            told = [client for client in self._hub.clients if not client.fresh]
            self._hub.tell(told, {"kind": "events", "events": new[-settings().events :]})

    # -- what pages are told, and ask for --------------------------------------------------------

    def _welcome(self, client: Client, panels: Panels) -> None:
        self._hub.tell(
            [client],
            {
                "kind": "hello",
                "runs": self._names,
                "live": self._live is not None,
                "operate": self._operation is not None,
                "asked": self._operate or bool(self._live and self._live.description.served),
                "lab": self._live is not None and self._shape.in_lab,
                "virtual": self._live is not None and self._live.description.virtual,
                "watch_s": settings().watch_s,
                "window_s": settings().window_s,
                "cables": self._shape.cables,
                "scale": {
                    "levels": self._shape.levels,
                    "colours": [colours.LOW, colours.PRE, colours.HIGH],
                },
                "plots": [plot.as_json() for plot in panels.plots],
                "signals": panels.names,
                "speeds": self._playback.speeds if self._playback else (),
                "length_s": self._playback.length_s if self._playback else None,
                "damage": [log.damage for log in self._playback.logs if log.damage]
                if self._playback
                else [],
                "events": list(self._events),
            },
        )

    def _now(self) -> Message:
        """Of this moment."""
        told: Message = {"kind": "now", "n": self._pictures}
        if self._moments:
            told["t"] = round(self._moments[0].time_s, 3)
            config = self._panels.config if self._panels is not None else None
            told["runs"] = [state_of(config, moment.newest) for moment in self._moments]
        if self._playback is not None:
            told["playing"], told["speed"] = self._playback.playing, self._playback.speed
        status = self._status
        if status is not None:
            told["status"] = status
            shown = told["runs"][0]["state"] if self._moments else ""
            state = State[shown if shown in State.__members__ else status["state"]]
            told["choices"] = choices(status, state)
        return told

    def _asked(self, client: Client, message: Message) -> None:
        """A message of a page; in the server's loop. What is not understood is ignored."""
        what = message.get("do")
        panels = self._panels
        if what == "choose" and panels is not None and isinstance(message.get("signals"), list):
            chosen = [name for name in message["signals"] if name in panels.known]
            client.chosen = chosen[:_CHOSEN]
            client.since = -np.inf
        elif what in ("play", "pause", "speed", "seek") and self._playback is not None:
            self._play(str(what), message.get("value"))
        elif what in ("command", "lab", "watch", "alive"):
            self._command(client, str(what), message)

    def _play(self, what: str, value: Any) -> None:
        playback = self._playback
        assert playback is not None
        if what in ("play", "pause"):
            playback.play(playing=what == "play")
        elif isinstance(value, int | float) and np.isfinite(value):
            (playback.seek if what == "seek" else playback.set_speed)(float(value))

    def _command(self, client: Client, what: str, message: Message) -> None:
        operation = self._operation
        number = message.get("id")

        def told(reply: Message) -> None:
            self._hub.tell([client], {"kind": "reply", "id": number, "reply": reply})

        if operation is None:
            told(REFUSED)
        elif what == "command":
            verb = str(message.get("verb"))
            fields = {name: message[name] for name in FIELDS if message.get(name) is not None}
            if verb == "start" and message.get("watch") is True:
                operation.watch(client.number, on=True)
            operation.command(verb, fields, told)
        elif what == "lab" and isinstance(message.get("request"), dict):
            operation.lab(message["request"], told)
        elif what == "watch":
            operation.watch(client.number, on=message.get("on") is True)
        elif what == "alive":
            operation.alive(client.number)

    def _left(self, client: Client) -> None:
        if self._operation is not None:
            self._operation.left(client.number)
