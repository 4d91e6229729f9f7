"""Values that depend on where a configuration runs: on a robot the safe ones, in a lab indulgent
ones, where nobody is hurt and the host has no real time."""

from __future__ import annotations

from typing import Any

from config.document import Key

DEFAULTS: dict[Key, tuple[Any, Any]] = {
    # R. EPOS4: a consumer waits at least 20 ms longer than the producer's period. The lab shares
    # its host, whose stalls of some ten milliseconds are no failure of the daemon.
    ("tolerance", "jitter_ms"): (20, 60),
}
"""Of a robot, and of a configuration with a lab section."""


def with_defaults(data: Any) -> Any:
    """A configuration's raw data with what it leaves out, by whether it has a lab. ``data`` stays
    as it is; what is not a mapping is left for the schema to refuse."""
    if not isinstance(data, dict):
        return data
    in_lab = data.get("lab") is not None
    data = {"tolerance": {}} | data
    for key, (safe, indulgent) in DEFAULTS.items():
        data = _filled(data, key, indulgent if in_lab else safe)
    return data


def _filled(data: Any, key: Key, value: Any) -> Any:
    """With ``value`` at ``key``, unless there is one, or nothing to hold it."""
    if not isinstance(data, dict):
        return data
    name, *rest = key
    if not rest:
        return {name: value} | data
    return data | {name: _filled(data[name], tuple(rest), value)} if name in data else data
