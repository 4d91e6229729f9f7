"""Values that depend on where a configuration runs: on a robot the safe ones, in a lab indulgent
ones, where nobody is hurt and the host has no real time. All R."""

from __future__ import annotations

from typing import Any, Literal

from tonus.config.document import Key, dotted

RelaxedKey = Literal[
    "realtime.policy",
    "realtime.overrun",
    "realtime.overrun_ticks",
    "control.freshness.stale_stop_ticks",
    "tolerance.jitter_ms",
    "supervisor.policy",
    "supervisor.period_ms",
    "supervisor.timeout_ms",
    "supervisor.patience_ms",
    "sto_relay.timeout_ms",
]
DEFAULTS: dict[Key, tuple[Any, Any]] = {
    ("realtime", "policy"): ("require", "prefer"),
    ("realtime", "overrun"): ("stop", "skip"),
    # As long as a measurement is fresh; in the lab each one counts, as nothing follows.
    ("realtime", "overrun_ticks"): (3, 1),
    # A measurement is usable for 3; the lab is a process of the same host and stalls with it.
    ("control", "freshness", "stale_stop_ticks"): (5, 25),
    # EPOS4: a consumer waits at least 20 ms longer than the producer's period. The lab shares
    # its host, whose stalls of some ten milliseconds are no failure of the daemon.
    ("tolerance", "jitter_ms"): (20, 60),
    ("supervisor", "policy"): ("require", "use"),
    # EPOS4: a consumer waits at least 20 ms longer than the producer's period.
    ("supervisor", "period_ms"): (2, 10),
    ("supervisor", "timeout_ms"): (22, 60),
    ("supervisor", "patience_ms"): (5, 40),
    # Two heartbeats of the supervisor may be lost, and a third be late.
    ("sto_relay", "timeout_ms"): (7, 60),
}
"""Of a robot, and of a configuration with a lab section."""
LARGEST_STALE_TICKS = 10
"""that need no word under ``relaxed``"""
LARGEST_JITTER_MS = 20
LARGEST_PERIOD_MS = 5
LARGEST_PATIENCE_MS = 10
LARGEST_TIMEOUT_MS = 50
LARGEST_RELAY_TIMEOUT_MS = 20


def with_defaults(data: Any) -> Any:
    """A configuration's raw data with what it leaves out: the safe values, with a lab section the
    indulgent ones, and those as well of keys that it names under ``relaxed``. ``data`` stays as it
    is; what is not a mapping is left for the schema to refuse."""
    if not isinstance(data, dict):
        return data
    in_lab, relaxed = data.get("lab") is not None, data.get("relaxed") or ()
    data = {"tolerance": {}} | data
    for key, (safe, indulgent) in DEFAULTS.items():
        named = isinstance(relaxed, list | tuple) and dotted(key) in relaxed
        data = _filled(data, key, indulgent if in_lab or named else safe)
    return data


def _filled(data: Any, key: Key, value: Any) -> Any:
    """With ``value`` at ``key``, unless there is one, or nothing to hold it."""
    if not isinstance(data, dict):
        return data
    name, *rest = key
    if not rest:
        return {name: value} | data
    return data | {name: _filled(data[name], tuple(rest), value)} if name in data else data
