"""Holds the robot when nobody watches any more: a process of its own, so that it also acts when the
viewer is killed or stopped.

    python -m tonus.tools.view.dead_man SOCKET

On its standard input "w" is a sign of life of a page that watches, "." ends the watch, and "x", or
the end of the input while someone was watching, says that the page is lost.
"""

from __future__ import annotations

import os
import select
import signal
import sys
from pathlib import Path

from tonus.runtime.states import State
from tonus.runtime.timing import clock
from tonus.tools.control_client import ControlClient
from tonus.tools.errors import ToolError
from tonus.tools.view.settings import settings

_AGAIN_S = 0.5
_ON_THE_WAY = (State.REFERENCING.name, State.PRETENSION.name)


def keep(socket: Path) -> None:
    """To the end of the input."""
    watched, ended = False, False
    while not ended:
        timeout = settings().watch_s if watched else None
        lost = not select.select([0], [], [], timeout)[0]
        if not lost:
            words = os.read(0, 4096)
            ended = not words
            last = words[-1:] or b"x"
            lost = watched and last == b"x"
            watched = last == b"w"
        if lost:
            watched = False
            _hold(socket)


def _hold(socket: Path) -> None:
    """Pause a robot that plays; stop one that is on its way up. One that holds or stops does so."""
    for _ in range(3):
        try:
            with ControlClient(socket) as daemon:
                state = daemon.ask("status").get("state")
                verb = {State.ACTIVE.name: "hold"}.get(str(state))
                if state in _ON_THE_WAY:
                    verb = "stop"
                if verb is None or daemon.ask(verb)["ok"]:
                    return
        except ToolError as error:
            sys.stderr.write(f"tonus view: the page is lost, and {error}\n")
            return
        clock.pause(_AGAIN_S)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    keep(Path(sys.argv[1]))
