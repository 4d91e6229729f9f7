"""A daemon in virtual time on a robot of stone, operated tick by tick at its control socket."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from statue import OVERRIDES, Statue

from tonus.config import Config, load
from tonus.config.loader import load_scenario
from tonus.drivers.fieldbus import BusEvent, Progress
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.daemon import Daemon, Outcome
from tonus.runtime.operation.control_door import ControlDoor
from tonus.runtime.operation.control_socket import ControlSocket
from tonus.runtime.operation.operator import Console, Script
from tonus.runtime.recording.taps import Level
from tonus.runtime.states import Fault, State
from tonus.runtime.timing import clock
from tonus.runtime.timing.scheduler import VirtualPacing

Spoil = Callable[[ProcessImage], None]
NAMES = ("hold", "sine_x", "sine_y")
RECOVERY_S = 0.005
TRAVEL: dict[str, Any] = OVERRIDES | {
    "operation.self_test.interval_ms": 5,
    "operation.self_test.maximum_age_ms": 12,
    "operation.socket.rate_hz": 1000.0,
}


class Event(NamedTuple):
    tick: int
    level: Level
    name: str
    where: str
    text: str


class Moment(NamedTuple):
    """What a tick came to."""

    tick: int
    state: State
    fault: Fault
    enabled: bool
    """some drive is told to be enabled"""
    operator: int


class StoneBus:
    """The statue's devices as a fieldbus; a test may spoil what they say."""

    channels: tuple[str, ...] = ()

    def __init__(self) -> None:
        self.statue = Statue()
        self.image = self.statue.image
        self.spoils: list[Spoil] = []
        self.bring_up_s = 0.0
        self.stopped = False

    async def start(self, progress: Progress) -> None:
        await asyncio.sleep(self.bring_up_s)

    def collect(self, tick: int) -> None:
        self.statue.number = tick
        self.statue.report()
        for spoil in self.spoils:
            spoil(self.image)

    def publish(self, tick: int) -> None: ...

    def take_events(self) -> list[BusEvent]:
        return []

    async def recover(self) -> None:
        await asyncio.sleep(RECOVERY_S)

    async def stop(self) -> None:
        self.stopped = True


class _NoTracker:
    def collect(self, now_ns: int) -> None: ...

    def take_events(self) -> list[BusEvent]:
        return []


class Client:
    """A connection that never waits: the daemon answers in its own ticks."""

    def __init__(self, path: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.setblocking(False)
        self._socket.connect(str(path))
        self._buffer = b""
        self.closed = False

    def send(self, data: bytes) -> None:
        self._socket.sendall(data)

    def ask(self, **request: Any) -> None:
        self.send(json.dumps(request).encode() + b"\n")

    def replies(self) -> list[dict[str, Any]]:
        """What has arrived."""
        while True:
            try:
                came = self._socket.recv(65536)
            except BlockingIOError:
                break
            except ConnectionResetError:
                came = b""
            if not came:
                self.closed = True
                break
            self._buffer += came
        *lines, self._buffer = self._buffer.split(b"\n")
        return [json.loads(line) for line in lines]

    def close(self) -> None:
        self._socket.close()


class Operated:
    """`advance` by ticks; `command` and see what came of it."""

    def __init__(
        self,
        folder: Path,
        *,
        overrides: dict[str, Any] | None = None,
        script: Script | None = None,
        bring_up_s: float = 0.0,
    ) -> None:
        self.config, first = load("config/can.yaml", NAMES[0], TRAVEL | (overrides or {}))
        self.catalogue = (first, *(load_scenario(name) for name in NAMES[1:]))
        self.bus = StoneBus()
        self.bus.bring_up_s = bring_up_s
        self.console = Console(script)
        self.failing = False
        """whether a test lets something fail inside the daemon"""
        self.history: list[Moment] = []
        self.events: list[Event] = []
        self.path = folder / "tonus.sock"
        self.socket = ControlSocket(self.path, self.config.operation.socket)
        self._runner = asyncio.Runner(loop_factory=clock.VirtualTimeLoop)
        self._running: asyncio.Task[Outcome] | None = None
        self._runner.run(self._start())
        self.client = Client(self.path)

    async def _start(self) -> None:
        self.daemon = Daemon(
            self.config,
            self.catalogue[0],
            self.bus,
            _NoTracker(),
            self.console,
            ring=self,
            events=lambda _, *event: self.events.append(Event(*event)),
            stopwatch=clock.Stopwatch(running=False),
            others=self.catalogue[1:],
        )
        self.bus.statue.cycle, self.bus.statue.record = self.daemon.cycle, self.daemon.cycle.record
        self.socket.open_to(
            ControlDoor(self.config, self.daemon, self.console, self.catalogue, "run.mcap")
        )
        self.daemon.serve("emergency stop", self.socket.listen, lasting=True)
        self.daemon.serve("control socket", self.socket.poll)
        running = self.daemon.run(VirtualPacing, lambda _: None, lambda: None)
        self._running = asyncio.get_running_loop().create_task(running)

    def publish(self, payload: NDArray[np.void], stamp_ns: int) -> None:
        """The cycle's ring."""
        record = payload[0]
        self.history.append(
            Moment(
                int(record["timing"]["tick"]),
                State(int(record["state"]["state"])),
                Fault(int(record["state"]["fault"])),
                bool((record["drives"]["command"] == 1).any()),
                int(record["state"]["operator"]),
            )
        )

    @property
    def state(self) -> State:
        return self.daemon.cycle.sequence.state

    @property
    def outcome(self) -> Outcome | None:
        assert self._running is not None
        return self._running.result() if self._running.done() else None

    def advance(self, ticks: int) -> None:
        """Let virtual time go on; an error in the daemon comes out here."""
        self._runner.run(asyncio.sleep(ticks * self.config.control.rates.period))
        assert self.failing or not self.daemon.firewall.tracebacks()
        outcome = self.outcome
        over = outcome is None or self.console.finished or not outcome.ticks
        assert self.failing or over

    def command(self, op: str, ticks: int = 4, **fields: Any) -> dict[str, Any]:
        """Ask, let a few ticks pass, and give the one reply."""
        self.client.ask(op=op, **fields)
        self.advance(ticks)
        (reply,) = self.client.replies()
        return reply

    def until(self, state: State, ticks: int = 2000) -> None:
        for _ in range(ticks):
            if self.state is state:
                return
            self.advance(1)
        raise AssertionError(f"{state.name} was not reached, but {self.state.name}")

    def bring_to(self, state: State) -> None:
        """As an operator would."""
        self.until(State.STANDBY)
        if state in (State.OFF, State.STANDBY):
            return
        self.advance(8)
        assert self.command("arm")["ok"]
        if state is State.REFERENCING:
            return
        self.until(State.PRETENSION if state is State.PRETENSION else State.HOLD)
        if state in (State.ACTIVE, State.SAFE_STOP, State.FAULT):
            assert self.command("start")["ok"]
        if state is State.SAFE_STOP:
            assert self.command("stop")["ok"]
        if state is State.FAULT:
            assert self.command("estop")["ok"]
        assert self.state is state

    def close(self) -> None:
        self.client.close()
        self.socket.close()
        self._runner.close()


def told(events: Iterable[Event], name: str) -> list[str]:
    """Texts of the events of a name."""
    return [event.text for event in events if event.name == name]


__all__ = ["NAMES", "Client", "Config", "Event", "Moment", "Operated", "told"]
