"""What disturbances on the same host make of the tick: `make load`.

    python -m tests.bench.load [--seconds S] [--only NAME]

One run undisturbed, one for each disturbance, one with all of them. Prints p99.9 of each beside
that of the first and exits with 1 when one is twice as large or we missed a tick by our own making.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from threading import Event

import click
from rich.console import Console
from rich.table import Table

from tests.bench.played import Played, p99_9, play
from tonus.runtime.recording.ring import RingError, RingReader

BUSY = 4
STOPPED_S = 3.0
"""how long the recorder is stopped; the rings hold eight seconds"""
LIMIT = 2.0
_BRING_UP_TICKS = 200
_SOCKET = "tonus.sock"
_BUSY = "while True: pass"
_SLOW = "dd if=/dev/zero of={path} bs=1M count=64 oflag=dsync conv=notrunc"

Daemon = subprocess.Popen[str]
Disturbance = Callable[[ExitStack, Daemon, Path, Path], str]
"""Begins; what ends it goes onto the stack. Says what it could not do, else nothing."""


def busy(cleanup: ExitStack, daemon: Daemon, runtime: Path, out: Path) -> str:
    """Four processes that never rest."""
    del daemon, runtime, out
    for _ in range(BUSY):
        cleanup.enter_context(_process([sys.executable, "-c", _BUSY]))
    return ""


def disk(cleanup: ExitStack, daemon: Daemon, runtime: Path, out: Path) -> str:
    """Synchronous writing to the folder the log is in, without an end."""
    del daemon, runtime
    script = f"while true; do {_SLOW.format(path=out / 'noise')} 2>/dev/null; done"
    cleanup.callback(lambda: (out / "noise").unlink(missing_ok=True))
    cleanup.enter_context(_process(["/bin/sh", "-c", script]))
    return ""


def flood(cleanup: ExitStack, daemon: Daemon, runtime: Path, out: Path) -> str:
    """A client that sends to the control socket as fast as it takes it, and reads nothing."""
    del daemon, out
    path = runtime / _SOCKET
    if not path.exists():
        return "there is no control socket"
    cleanup.enter_context(
        _process([sys.executable, "-m", "tests.bench.load", "--flood", str(path)])
    )
    return ""


def stopped(cleanup: ExitStack, daemon: Daemon, runtime: Path, out: Path) -> str:
    """A recorder that does nothing for a while."""
    del runtime, out
    recorder = _child(daemon.pid, "tonus.tools.run.recorder_process")
    if recorder is None:
        return "there is no recorder"
    os.kill(recorder, signal.SIGSTOP)

    def go_on() -> None:
        with suppress(ProcessLookupError):
            os.kill(recorder, signal.SIGCONT)

    cleanup.callback(go_on)
    return ""


DISTURBANCES: dict[str, tuple[Disturbance, ...]] = {
    "nothing": (),
    "four busy processes": (busy,),
    "slow disk": (disk,),
    "flooded socket": (flood,),
    "stopped recorder": (stopped,),
    "all of them": (busy, disk, flood, stopped),
}


def disturbed(what: tuple[Disturbance, ...], seconds: float, say: Callable[[str], None]) -> Played:
    """A run of ``seconds`` that is disturbed from its first ticks on, the recorder for less."""

    def meanwhile(daemon: Daemon, runtime: Path, out: Path) -> None:
        _wait_for_ticks(daemon, runtime)
        short = [action for action in what if action is stopped]
        with ExitStack() as cleanup:
            for action in what:
                if action not in short:
                    said = action(cleanup, daemon, runtime, out)
                    if said:
                        say(f"  {said}")
            with ExitStack() as soon:
                for action in short:
                    action(soon, daemon, runtime, out)
                    Event().wait(STOPPED_S)
            with suppress(subprocess.TimeoutExpired):
                daemon.wait(seconds + 60.0)

    return play(seconds, meanwhile=meanwhile if what else None)


def _wait_for_ticks(daemon: Daemon, runtime: Path) -> None:
    """Until the rings of a running daemon fill."""
    for _ in range(1200):
        for path in runtime.glob("run-*/cycle.ring"):
            with suppress(RingError, OSError):
                reader = RingReader.open(path)
                published = reader.published
                reader.close()
                if published > _BRING_UP_TICKS:
                    return
        if daemon.poll() is not None:
            return
        Event().wait(0.05)


def _child(parent: int, module: str) -> int | None:
    """A process that ``parent`` started for ``module``."""
    for entry in Path("/proc").iterdir():
        if not entry.name.isdecimal():
            continue
        with suppress(OSError):
            words = (entry / "cmdline").read_bytes().split(b"\0")
            started_by = (entry / "stat").read_text().rsplit(")", 1)[1].split()[1]
            if module.encode() in words and int(started_by) == parent:
                return int(entry.name)
    return None


@contextmanager
def _process(command: list[str]) -> Iterator[None]:
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        yield
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _flood(path: str) -> None:
    """Requests and rubbish in turn, for ever; a connection that is closed is opened again."""
    message = b'{"verb":"status"}\n' * 50 + b"x" * 5000 + b"\n"
    while True:
        with suppress(OSError), socket.socket(socket.AF_UNIX) as client:
            client.settimeout(1.0)
            client.connect(path)
            while True:
                client.sendall(message)


@click.command()
@click.option("--seconds", type=click.FloatRange(min=5.0), default=20.0, show_default=True)
@click.option("--only", type=click.Choice(list(DISTURBANCES)), help="Only this one, and nothing.")
@click.option("--flood", "socket_path", hidden=True)
def main(seconds: float, only: str | None, socket_path: str | None) -> None:
    """Run undisturbed, then with each disturbance."""
    if socket_path is not None:
        _flood(socket_path)
    console = Console(highlight=False, soft_wrap=True)
    names = list(DISTURBANCES) if only is None else ["nothing", only]
    runs = {}
    for name in names:
        console.print(f"{name}: {seconds:g} s and the bring-up")
        runs[name] = disturbed(DISTURBANCES[name], seconds, console.print)
    quiet, good = runs["nothing"], True
    table = Table("p99.9 in us", "wake-up", "ratio", "due to published", "ratio", "own", "host", "")
    for name, run in runs.items():
        wakeup = p99_9(run.wakeup) / p99_9(quiet.wakeup)
        response = p99_9(run.response) / p99_9(quiet.response)
        fine = wakeup < LIMIT and response < LIMIT and not run.own and not run.faults
        good = good and fine
        table.add_row(
            name,
            f"{p99_9(run.wakeup):.1f}",
            f"{wakeup:.2f}",
            f"{p99_9(run.response):.0f}",
            f"{response:.2f}",
            str(run.own),
            str(run.host),
            "met" if fine else "; ".join(("MISSED", *run.faults)),
        )
    console.print(table)
    console.print(f"ratios to the first row; below {LIMIT:g} and no tick of our own is asked for")
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
