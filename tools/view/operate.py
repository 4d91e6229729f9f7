"""Commands of a page: through the control socket of the daemon and the lab's, as `tonus ctl` and
`tonus fault` give them, with the credentials of whoever started the viewer.
"""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from tonus.runtime.operation.verbs import VERBS
from tonus.runtime.states import NEXT, TRANSITIONS, Event, Operator, State
from tonus.tools.control_client import ControlClient
from tonus.tools.errors import ToolError
from tonus.tools.run.lab_door import ask as ask_lab

Reply = dict[str, Any]
Told = Callable[[Reply], None]
_MOST_WAITING = 16
"""requests of all pages, beside emergency stops"""
FIELDS = ("name", "key", "value")
"""of a request to the daemon, beside op"""
_LAB_OPS = ("get", "kinds", "inject", "clear")
REFUSED = {
    "ok": False,
    "error": "this viewer only shows",
    "next": "start it with: tonus view --operate",
}


class DeadMan:
    """A process of its own that holds the robot when its signs of life stop: also if this viewer is
    killed, or stopped."""

    def __init__(self, socket: Path) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tonus.tools.view.dead_man", str(socket)],
            stdin=subprocess.PIPE,
        )

    def say(self, word: bytes) -> None:
        """``b"w"``: someone watches; ``b"."``: nobody needs to."""
        pipe = self._process.stdin
        assert pipe is not None
        try:
            pipe.write(word)
            pipe.flush()
        except OSError as error:
            raise ToolError("the process that watches over the page is gone") from error

    def close(self) -> None:
        """End it; where someone was watching, the robot holds."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._process.wait(5.0)


class Operation:
    """Commands to one daemon, and to its lab. Each is answered in its turn, an emergency stop at
    once, on a connection of its own."""

    def __init__(self, socket: Path) -> None:
        self._socket = socket
        self._commands = ThreadPoolExecutor(1, thread_name_prefix="commands")
        self._stops = ThreadPoolExecutor(2, thread_name_prefix="emergency stop")
        self._lab = ThreadPoolExecutor(1, thread_name_prefix="lab")
        self._dead_man = DeadMan(socket)
        self._watching: int | None = None
        """number of the page that started the robot and watches"""
        self._waiting = 0
        self._lock = threading.Lock()

    def command(self, verb: str, fields: Reply, told: Told) -> None:
        """``told`` gets the daemon's reply, in another thread. ``fields`` of the request are
        `FIELDS`."""
        if verb not in VERBS:
            told({"ok": False, "error": f"there is no command {verb[:40]!r}", "next": "reload"})
            return
        if verb == "estop":
            self._stops.submit(self._ask, verb, fields, told)
        else:
            self._submit(self._commands, told, self._ask, verb, fields)

    def _submit(
        self, pool: ThreadPoolExecutor, told: Told, ask: Callable[..., None], *given: Any
    ) -> None:
        """In its turn, unless too many wait already."""
        with self._lock:
            full = self._waiting >= _MOST_WAITING
            self._waiting += not full
        if full:
            told({"ok": False, "error": "too many requests wait", "next": "send less"})
            return

        def work() -> None:
            try:
                ask(*given, told)
            finally:
                with self._lock:
                    self._waiting -= 1

        pool.submit(work)

    def _ask(self, verb: str, fields: Reply, told: Told) -> None:
        try:
            with ControlClient(self._socket) as daemon:
                reply = daemon.ask(verb, **fields)
        except ToolError as error:
            reply = {"ok": False, "error": str(error), "next": ""}
        told(reply)

    def lab(self, request: Reply, told: Told) -> None:
        """One request to the lab's control socket, likewise."""
        if request.get("op") not in _LAB_OPS:
            told({"ok": False, "error": "the lab has no such request", "next": ""})
            return
        self._submit(self._lab, told, self._ask_lab, request)

    def _ask_lab(self, request: Reply, told: Told) -> None:
        try:
            told(ask_lab(request))
        except ToolError as error:
            told({"ok": False, "error": str(error), "next": ""})

    def watch(self, page: int, *, on: bool) -> None:
        """This page starts, or ends, to watch over the robot."""
        with self._lock:
            if on:
                self._watching = page
                self._dead_man.say(b"w")
            elif self._watching == page:
                self._watching = None
                self._dead_man.say(b".")

    def alive(self, page: int) -> None:
        """A sign of life of a page."""
        with self._lock:
            if self._watching == page:
                self._dead_man.say(b"w")

    def left(self, page: int) -> None:
        """A page is gone. If it was the one that watches, no further sign of life comes and the
        robot holds."""
        with self._lock:
            if self._watching == page:
                self._watching = None
                self._dead_man.say(b"x")

    def close(self) -> None:
        """Let go of everything."""
        for pool in (self._commands, self._stops, self._lab):
            pool.shutdown(wait=False, cancel_futures=True)
        self._dead_man.close()


def choices(status: Reply, state: State) -> list[Reply]:
    """Each command: whether it is allowed in this state, and why not. ``status`` may be older."""
    found = []
    for verb in VERBS.values():
        if verb.operator is Operator.NONE:
            continue
        why = ""
        if verb.operator is Operator.ESTOP:
            pass
        elif not status["served"] and verb.operator is not Operator.STOP:
            why = "a script runs this daemon"
        elif status["recovering"]:
            why = "a reset is bringing devices back"
        elif TRANSITIONS[state, Event(verb.operator)] is state:
            why = f"not allowed in {state.name}; {NEXT[state]}"
        elif verb.operator is Operator.ARM:
            why = "; ".join(each["text"] for each in status["self_test"] if not each["ok"])
        found.append({"verb": verb.name, "about": verb.about, "why": why})
    return found
