"""Names of events that a question may ask for: a misspelt one would be met for ever by `never`."""

from __future__ import annotations

from difflib import get_close_matches
from functools import cache

from tonus.drivers import events as drivers
from tonus.runtime import events as daemon
from tonus.runtime.safety import firewall
from tonus.runtime.states import Fault
from tonus.tools.errors import ToolError


@cache
def known() -> frozenset[str]:
    """Those of docs/events.md."""
    faults = (fault.name.lower() for fault in Fault)
    return frozenset({*daemon.EVENTS, *drivers.EVENTS, *firewall.EVENTS, *faults})


def need_known(name: str) -> None:
    """Raises `ToolError` for a name, without ``*`` and ``?``, that no event of ours has."""
    if name in known() or "*" in name or "?" in name:
        return
    close = get_close_matches(name, known(), 1)
    guess = f"; did you mean {close[0]}?" if close else "; docs/events.md lists them"
    raise ToolError(f"no event is named {name}{guess}")
