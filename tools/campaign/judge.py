"""An episode's row: what struck, what became of it, and which bounds it broke."""

from __future__ import annotations

import json
from hashlib import blake2b
from typing import Any

import numpy as np

from tonus.runtime.states import State, StopMode
from tonus.tools.campaign.allowance import Allowance, for_torn_cables
from tonus.tools.campaign.episode import Episode
from tonus.tools.campaign.invariants import Violation, within_bounds
from tonus.tools.campaign.observed import Observed
from tonus.tools.campaign.strikes import NS
from tonus.tools.campaign.supervised import account

Row = dict[str, Any]


def row_of(
    episode: Episode, run: Observed, *, replayed: bool, allowance: Allowance = for_torn_cables
) -> Row:
    """One JSON object: the whole episode, its strikes with the states they met, its end, what its
    supervisor did, its violations and its extremes."""
    violations = within_bounds(run, allowance=allowance, replayed=replayed)
    speed = np.linalg.norm(run.truth["velocity"], axis=1)
    end = run.end
    return {
        "index": episode.index,
        "episode": json.loads(episode.model_dump_json(exclude_defaults=True)),
        "strikes": [
            {"kind": strike.kind, "at": strike.at_ns / NS, "state": state_at(run, strike.at_ns)}
            for strike in run.strikes
        ],
        "state": end.state.name if end is not None else "",
        "fault": end.fault.name if end is not None else "",
        "reason": end.reason if end is not None else run.error,
        "supervisor": account(run),
        "stop_mode": StopMode(int(run.cycle["state"]["stop_mode"].max(initial=0))).name,
        "excluded": np.flatnonzero(run.cycle["state"]["failed"].any(axis=0)).tolist(),
        "ticks": len(run.cycle_ns),
        "digest": digest(run),
        "speed": round(float(speed.max(initial=0.0)), 4),
        "tension": round(float(run.truth["tension"].max(initial=0.0)), 2),
        "contact": round(float(run.truth["contact_force"].max(initial=0.0)), 2),
        "violations": [told(violation) for violation in violations],
    }


def failed(episode: Episode, invariant: str, text: str) -> Row:
    """The row of an episode whose process did not live to write one."""
    violation = Violation(invariant, 0.0, 1.0, 0.0, text)
    return {
        "index": episode.index,
        "episode": json.loads(episode.model_dump_json(exclude_defaults=True)),
        "strikes": [],
        "state": "",
        "fault": "",
        "reason": text,
        "supervisor": None,
        "stop_mode": "",
        "excluded": [],
        "ticks": 0,
        "digest": "",
        "speed": 0.0,
        "tension": 0.0,
        "contact": 0.0,
        "violations": [told(violation)],
    }


def digest(run: Observed) -> str:
    """Of every bit that was recorded: equal for equal runs."""
    found = blake2b(digest_size=8)
    assert isinstance(run.cycle, np.ndarray), "a log has no record of a tick in one piece"
    for part in (run.cycle, run.cycle_ns, run.truth, run.truth_ns):
        found.update(np.ascontiguousarray(part).tobytes())
    for event in run.events:
        found.update(repr(event).encode())
    return found.hexdigest()


def told(violation: Violation) -> dict[str, Any]:
    """A violation as a row has it."""
    return {
        "invariant": violation.invariant,
        "at": round(violation.at_s, 4),
        "value": float(f"{violation.value:.4g}"),
        "bound": float(f"{violation.bound:.4g}"),
        "text": violation.text,
    }


def state_at(run: Observed, at_ns: int) -> str:
    """The state of the machine at a time."""
    row = int(np.searchsorted(run.cycle_ns, at_ns)) - 1
    return State(int(run.state[row])).name if row >= 0 else State.OFF.name
