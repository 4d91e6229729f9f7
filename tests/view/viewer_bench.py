"""A viewer as a process, and a page without a browser."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from tests.loop import QUICK
from tonus.runtime.signals import SCHEMA_VERSION
from tonus.runtime.timing import clock

TONUS = [sys.executable, "-m", "tonus.tools.cli"]
ROOT = Path(__file__).resolve().parents[2]
GOLDEN = ROOT / f"tests/replay/golden/v{SCHEMA_VERSION}.mcap"
TOKEN = "a-token-for-tests-only"  # noqa: S105
PATIENCE_S = 60.0


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    with socket.socket(type=kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _end(process: subprocess.Popen[bytes], patience_s: float, text: Path) -> None:
    """One that does not end when it is asked is a failure that tells where each of its threads
    is, and leaves nothing that computes."""
    process.terminate()
    try:
        process.wait(patience_s)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGABRT)
        process.wait()
        pytest.fail(f"it does not end: {text.read_text()}")


def _environment(folder: Path) -> dict[str, str]:
    told = {"TONUS_RUNTIME_DIR": str(folder / "runtime"), "PYTHONFAULTHANDLER": "1"}
    return {**os.environ, **told}


class Viewer:
    """`tonus view` with these arguments; ``with_token`` names the one it has."""

    def __init__(self, folder: Path, *arguments: str, token: str | None = None) -> None:
        self.port, self.token = free_port(), token
        self.text = folder / f"view-{self.port}.txt"
        command = [*TONUS, "view", "--port", str(self.port), *arguments]
        if token is not None:
            command += ["--token", token]
        self.process = subprocess.Popen(
            command,
            cwd=ROOT,
            env=_environment(folder),
            stdout=self.text.open("w"),
            stderr=subprocess.STDOUT,
        )
        for _ in range(int(PATIENCE_S / 0.05)):
            if "open http" in self.text.read_text() or self.process.poll() is not None:
                break
            clock.pause(0.05)
        assert self.process.poll() is None, self.text.read_text()

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def address(self) -> str:
        return f"{self.origin}/?token={self.token}" if self.token else f"{self.origin}/"

    def connect(
        self, path: str = "/channel", origin: str | None = "", token: str | None = "", **more: Any
    ) -> ClientConnection:
        """As the page does, unless told otherwise."""
        token = self.token if token == "" else token
        headers = {"Cookie": f"tonus-{self.port}={token}"} if token else {}
        return connect(
            f"ws://127.0.0.1:{self.port}{path}",
            origin=self.origin if origin == "" else origin,  # type: ignore[arg-type]
            additional_headers=headers,
            max_size=None,
            # One that has not read what was sent does not see the end that it asks for.
            close_timeout=0.5,
            **more,
        )

    def memory(self) -> float:
        """Bytes in use; the peak is counted from here on."""
        process = Path(f"/proc/{self.process.pid}")
        (process / "clear_refs").write_text("5")
        return _bytes(process, "VmRSS")

    def peak(self) -> float:
        """Bytes, the most in use since `memory` was asked."""
        return _bytes(Path(f"/proc/{self.process.pid}"), "VmHWM")

    def close(self) -> None:
        _end(self.process, 20, self.text)


def _bytes(process: Path, name: str) -> float:
    lines = (process / "status").read_text().splitlines()
    (line,) = (line for line in lines if line.startswith(f"{name}:"))
    return 1024 * float(line.split()[1])


def ended(connection: ClientConnection) -> int:
    """Wait for the end of a connection, and give its code; 1006 for an end without one."""
    try:
        while True:
            connection.recv(PATIENCE_S)
    except ConnectionClosed as closed:
        return closed.rcvd.code if closed.rcvd else 1006


class Page:
    """What a page gets, and asks for."""

    def __init__(self, connection: ClientConnection) -> None:
        self.connection = connection
        self.events: list[dict[str, Any]] = []
        self.hello = self.next("hello")
        self.events += self.hello["events"]
        self._number = 0

    def next(self, kind: str) -> dict[str, Any]:
        while True:
            message: dict[str, Any] = json.loads(self.connection.recv(PATIENCE_S))
            if message["kind"] == "events":
                self.events += message["events"]
            if message["kind"] == kind:
                return message

    def send(self, **message: Any) -> None:
        self.connection.send(json.dumps(message))

    def ask(self, **message: Any) -> dict[str, Any]:
        """The reply to a request."""
        self._number += 1
        self.send(**message, id=self._number)
        while True:
            told = self.next("reply")
            if told["id"] == self._number:
                return dict(told["reply"])

    def command(self, verb: str, **more: Any) -> dict[str, Any]:
        return self.ask(do="command", verb=verb, **more)

    def arm(self) -> None:
        """To HOLD; the self-test may still have to come to its result."""
        self.until(lambda now: "status" in now)
        for _ in range(40):
            reply = self.command("arm")
            if reply["ok"]:
                break
            clock.pause(0.25)
        assert reply["ok"], reply
        self.state("HOLD")

    def until(self, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """The first picture of which it holds."""
        for _ in range(int(PATIENCE_S * 30)):
            now = self.next("now")
            if condition(now):
                return now
        raise AssertionError(f"it did not happen; last: {now}")

    def state(self, *wanted: str) -> dict[str, Any]:
        return self.until(lambda now: now["runs"][0]["state"] in wanted)


@contextmanager
def opened(viewer: Viewer) -> Iterator[Page]:
    with viewer.connect() as connection:
        yield Page(connection)


class Served:
    """A daemon that serves, with its lab."""

    def __init__(self, folder: Path, config: str, *arguments: str) -> None:
        self.text = folder / "run.txt"
        # Its lab has no load, which would push a platform that lies in its cradle.
        command = [*TONUS, "run", config, "--serve", "--scenario", "hold"]
        command += ["--out", str(folder / "out"), *arguments]
        # A lab of another test may still be running, and its tracker would be heard here too.
        changed = {**QUICK, "tracker.port": free_port(socket.SOCK_DGRAM)}
        command += [f"--set={key}={value}" for key, value in changed.items()]
        self.process = subprocess.Popen(
            command,
            cwd=ROOT,
            env=_environment(folder),
            stdout=self.text.open("w"),
            stderr=subprocess.STDOUT,
        )
        for _ in range(int(2 * PATIENCE_S / 0.05)):
            if "STANDBY" in self.text.read_text() or self.process.poll() is not None:
                break
            clock.pause(0.05)
        assert self.process.poll() is None, self.text.read_text()

    def close(self) -> None:
        _end(self.process, 60, self.text)


def recorded(
    folder: Path,
    name: str = "recorded",
    *,
    config: str = "config/direct.yaml",
    scenario: str = "sine_z",
    seconds: float = 3.0,
    **sequence: float,
) -> Path:
    """The log of a short run in virtual time; ``sequence``: changed keys of control.sequence."""
    out = folder / name
    arguments = [config, "--virtual", "--scenario", scenario]
    arguments += ["--duration", str(seconds), "--out", str(out)]
    changed = {f"control.sequence.{key}": value for key, value in sequence.items()}
    arguments += [f"--set={key}={value}" for key, value in (QUICK | changed).items()]
    subprocess.run(
        [*TONUS, "run", *arguments],
        cwd=ROOT,
        env=_environment(folder),
        check=True,
        capture_output=True,
    )
    return out / "run.mcap"
