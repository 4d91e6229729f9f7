"""What the supervisor did in a run, by its own word, which the daemon has logged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tonus.runtime.states import Fault, State
from tonus.tools.campaign.strikes import NS
from tonus.tools.run.supervision import wanted

if TYPE_CHECKING:
    from tonus.config.schema.root import Config
    from tonus.tools.campaign.observed import Observed

_STOPPED, _MISSED = "supervisor_stopped", "unsupervised"


@dataclass(frozen=True)
class Stop:
    """The supervisor has found a requirement broken, and ended its heartbeat."""

    at_ns: int
    """on the clock of the records: when the daemon received it"""
    text: str
    """requirement, place and value: SUP-10 at 2, 17.5"""
    state: State
    """of the daemon at that time"""
    fault: Fault
    """the first that the daemon had found by then"""

    @property
    def requirement(self) -> str:
        return self.text.replace(",", " ").split(" ", 1)[0]

    def told(self) -> dict[str, Any]:
        """As a row has it."""
        return {
            "requirement": self.requirement,
            "at": round(self.at_ns / NS, 4),
            "state": self.state.name,
            "fault": self.fault.name,
            "text": self.text,
        }


def stops(run: Observed) -> list[Stop]:
    """In the order of time. On every channel it says the same, and on a busy one late or again."""
    found: dict[str, Stop] = {}
    for event in run.events:
        text = event.text.split(":", 1)[0]
        if event.name == _STOPPED and text not in found:
            row = max(int(np.searchsorted(run.cycle_ns, event.time_ns)) - 1, 0)
            state = run.cycle["state"][row]
            named = State(int(state["state"])), Fault(int(state["fault"]))
            found[text] = Stop(event.time_ns, text, *named)
    return sorted(found.values(), key=lambda stop: stop.at_ns)


def account(run: Observed) -> Mapping[str, Any] | None:
    """Whether a run was supervised while its drives were enabled, and every stop; None for a run
    that has no supervisor."""
    if not wanted(run.config):
        return None
    missed = any(event.name == _MISSED for event in run.events)
    return {"there": not missed, "stops": [stop.told() for stop in stops(run)]}


def reach_ns(config: Config) -> int:
    """From its silence until no drive does what the daemon says."""
    settings, relay = config.supervisor, config.relay
    if relay is not None:
        return round((relay.release_ms + relay.torque_off_ms) * 1e6)
    return 0 if settings is None else settings.timeout_ms * 1_000_000
