"""Names that a question may ask for: a misspelt event would be met for ever by `Run.never`."""

from __future__ import annotations

from difflib import get_close_matches
from functools import cache

from tonus.drivers import events as drivers
from tonus.runtime import events as daemon
from tonus.runtime.safety import firewall
from tonus.runtime.signals import TABLE
from tonus.runtime.states import Fault
from tonus.tools.errors import ToolError
from tonus.tools.run.truth import TOPIC


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


def full(topic: str) -> str:
    """A topic's name with its /tonus/, which a question may leave out."""
    return topic if topic.startswith("/") else f"/tonus/{topic}"


@cache
def signals() -> dict[str, dict[str, int]]:
    """By topic and field: the size of each signal that a run in the lab has, as
    `tonus.runtime.topics.Field` states it."""
    return {
        topic.name: {each.name: each.size for each in topic.fields} for topic in (*TABLE, TOPIC)
    }


def advice(topic: str, field: str) -> str:
    """What may have been meant by a signal; empty where it is one, or nothing is near."""
    known = signals()
    if topic not in known:
        close = get_close_matches(topic, known, 1)
        return f"did you mean {close[0]}?" if close else ""
    if field in known[topic]:
        return ""
    close = get_close_matches(field, known[topic], 1)
    return f"did you mean {close[0]}?" if close else f"it has {', '.join(known[topic])}"
