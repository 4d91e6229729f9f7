"""A daemon and its lab for one test: processes of their own, in real time."""

from __future__ import annotations

import fcntl
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tonus.config.loader import load_scenario
from tonus.config.schema.faults import Fault
from tonus.runtime.timing import clock
from tonus.tools.control_client import ControlClient
from tonus.tools.errors import ToolError
from tonus.tools.expect import Run
from tonus.tools.log import open as open_log
from tonus.tools.run.lab_door import ask
from tonus.tools.testing.case import Case
from tonus.tools.testing.lab import made

_LOOK_S = 0.05
_PATIENCE_S = 60.0
"""for what a daemon does, on a busy host"""


class DaemonFactory:
    """The fixture ``tonus_daemon``. One daemon runs at a time on a host, whichever process of a
    parallel pytest asks for it."""

    def __init__(self, case: Case) -> None:
        self._case = case

    def __call__(
        self,
        scenario: str | Path = "hold",
        *,
        config: str | Path | None = None,
        seed: int | None = None,
        overrides: dict[str, Any] | None = None,
    ) -> Daemon:
        """Start ``tonus run --serve`` and wait until it is in STANDBY. Raises `ToolError` with the
        daemon's own words if it does not get there."""
        case = self._case
        # Checked here: the command's process would say the same, but later.
        case.configuration(config, overrides)
        load_scenario(case.place(scenario))
        case.closing.enter_context(_alone())
        daemon = Daemon(
            case,
            case.place(scenario),
            case.place(case.config if config is None else config),
            {"tracker.port": _free_port(), **case.overrides, **(overrides or {})},
            case.seeded(seed),
        )
        case.closing.callback(daemon.kill)
        case.open.append(daemon.end)
        daemon.wait_for("STANDBY")
        return daemon


class Daemon:
    """A running daemon that obeys commands (docs/operation.md)."""

    def __init__(
        self, case: Case, scenario: str, config: str, overrides: dict[str, Any], seed: int
    ) -> None:
        self._case = case
        self._out = case.folder()
        self._text = self._out / "daemon.txt"
        settings = [f"--set={key}={json.dumps(value)}" for key, value in overrides.items()]
        command = [
            *(sys.executable, "-m", "tonus.tools.cli", "run", config, "--serve"),
            *("--scenario", scenario, "--seed", str(seed), "--out", str(self._out / "runs")),
        ]
        self._began = clock.wall_seconds()
        with self._text.open("w") as text:
            self._process = subprocess.Popen(
                [*command, *settings], stdout=text, stderr=subprocess.STDOUT
            )
        self._ready = self._began
        self._run: Run | None = None
        self._injected: list[tuple[int, Fault]] = []
        self._resetting = False
        """a reset was given, and it has not been seen to be over"""

    def status(self) -> dict[str, Any]:
        """What the daemon does (docs/operation.md). Raises `ToolError` if it has ended."""
        return self._ask("status")

    def command(self, verb: str) -> dict[str, Any]:
        """Give one of the commands arm, start, hold, stop, estop, reset. Raises `ToolError` for one
        that is refused."""
        reply = self._ask(verb)
        if not reply["ok"]:
            raise ToolError(f"{verb} is refused: {reply['error']}; {reply.get('remedy', '')}")
        self._resetting |= verb == "reset"
        return reply

    def arm(self) -> None:
        """Arm the robot and wait until it is in HOLD."""
        self.command("arm")
        self.wait_for("HOLD")

    def play(self, seconds: float) -> None:
        """Start the scenario and let it play for so long."""
        self.command("start")
        self.wait_for("ACTIVE")
        clock.pause(seconds)

    def wait_for(self, state: str, within: float = _PATIENCE_S) -> None:
        """Wait until the robot is in a state; s of real time. Raises `ToolError` if it is not in
        time, and where it ends in FAULT instead. After a reset it is in FAULT until every device
        has been brought back."""
        end = clock.wall_seconds() + within
        reached = ""
        while reached != state:
            if self._process.poll() is not None:
                raise ToolError(f"the daemon has ended: {self._said()}")
            try:
                status = self._ask("status")
            except ToolError:
                status = {"state": "", "fault": None}  # it starts still
            reached = status["state"]
            self._resetting &= reached == "FAULT"
            if reached == "FAULT" and state != "FAULT" and not self._resetting:
                own, host = status["missed_own"], status["missed_host"]
                missed = f"; missed ticks: {own} own, {host} by the host" if own + host else ""
                told = f"{status['fault']}{missed}"
                raise ToolError(f"the robot is in FAULT and not in {state}: {told}")
            if clock.wall_seconds() > end:
                raise ToolError(f"{state} was not reached in {within:g} s; it is in {reached}")
            if reached != state:
                clock.pause(_LOOK_S)
        if state == "STANDBY" and self._ready == self._began:
            self._ready = clock.wall_seconds()

    def fault(self, fault: Fault | str, **fields: Any) -> None:
        """Inject a fault into the daemon's lab, as `VirtualLab.fault`. Raises `ToolError`."""
        given = made(fault, fields)
        now_ns = round(clock.wall_seconds() * 1e9) + clock.utc_offset_ns()
        ask({"op": "inject", "fault": given.model_dump(mode="json")})
        self._injected.append((now_ns, given))

    def end(self) -> Run:
        """A controlled stop, and the end of the daemon. Raises `ToolError` if there is no log."""
        if self._run is not None:
            return self._run
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
        self._process.wait(_PATIENCE_S)
        ended = clock.wall_seconds()
        logs = sorted(self._out.glob("runs/*/run.mcap"))
        if not logs:
            raise ToolError(f"the daemon recorded nothing: {self._said()}")
        run = Run(open_log(logs[-1]), injected=self._injected)
        self._run = self._case.ran(run, ended - self._began, ended - self._ready)
        return run

    def kill(self) -> None:
        """End it at once, if it has not ended; no run of it is judged or kept."""
        with suppress(ValueError):
            self._case.open.remove(self.end)
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
            try:
                self._process.wait(_PATIENCE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def _ask(self, verb: str) -> dict[str, Any]:
        with ControlClient() as client:
            return client.ask(verb)

    def _said(self) -> str:
        lines = self._text.read_text(errors="replace").strip().splitlines()
        return lines[-1].strip() if lines else "it said nothing"


@contextmanager
def _alone() -> Iterator[None]:
    """One daemon on this host at a time: two would take each other's processor time."""
    path = Path(tempfile.gettempdir()) / f"tonus-real-time-{os.getuid()}.lock"
    with path.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _free_port() -> int:
    """A UDP port of the tracker that nobody has."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
