"""summary.json: what a script wants to know about a run, computed from its log alone."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.states import Fault, State
from tools.log import Log

Array = NDArray[np.float64]
Summary = dict[str, Any]

TRUTH = "/tonus/truth"
_RUNNING = (State.HOLD, State.ACTIVE)
_NEEDED = (
    "/tonus/timing",
    "/tonus/state",
    "/tonus/pose",
    "/tonus/stiffness",
    "/tonus/tension",
    "/tonus/wrench",
)


def summarise(
    log: Log,
    *,
    realtime_factor: float | None = None,
    steal_percent: float | None = None,
    reason: str | None = None,
) -> Summary:
    """The keys of summary.json. What a run did not give is None: accuracy without a lab's truth,
    latencies without a cycle.

    Tracking is judged in ACTIVE; tension and stiffness in HOLD and ACTIVE; contact, timing and
    faults over the whole log.
    """
    log.load([topic for topic in (*_NEEDED, TRUTH) if topic in log])
    timing, state = log["/tonus/timing"], log["/tonus/state"]
    faults = find_faults(log)
    phase = state["state"]
    running, active = np.isin(phase, _RUNNING), phase == State.ACTIVE
    cycle_us = timing["collect_us"] + timing["compute_us"] + timing["publish_us"]
    return {
        "state": State(int(phase[-1])).name if len(phase) else None,
        "reason": reason or (_blame(faults[-1]) if faults else "completed"),
        "ticks": len(timing),
        "missed_ticks": _last(timing["missed_own"]),
        "realtime_factor": realtime_factor,
        "wakeup_us": percentiles(timing["wakeup_us"]),
        "cycle_us": percentiles(cycle_us),
        "missed_by_host": _last(timing["missed_host"]),
        "steal_percent": steal_percent,
        **_host(timing, active),
        "tracking_rmse_m": _tracking(log, active),
        "tension_rmse_n": _tension_error(log, running),
        "k_eq_n_per_m": _range(log["/tonus/stiffness"]["k_eq"][running]),
        "tension_n": _range(tensions(log)[running]),
        "contact_peak_n": _contact_peak(log),
        "faults": faults,
        "seed": _seed(log),
        "log": log.path.name,
    }


def _host(timing: NDArray[Any], active: NDArray[np.bool_]) -> Summary:
    """What else the cycles say about time, as far as the log has it: older ones do not."""
    names = timing.dtype.names or ()
    found: Summary = {"compute_us": percentiles(timing["compute_us"])}
    found["bus_us"] = percentiles(timing["bus_us"]) if "bus_us" in names else None
    found["slack_us"] = _left(timing["slack_us"]) if "slack_us" in names else None
    for name in ("page_faults", "switches"):
        rises = np.diff(timing[name].astype(np.int64), prepend=0) if name in names else None
        found[f"active_{name}"] = None if rises is None else int(rises[active].sum())
    return found


def _left(slack: NDArray[Any]) -> dict[str, float] | None:
    """Of what should be large, the small end."""
    if not len(slack):
        return None
    p50, p1, p0_1 = np.percentile(slack, (50.0, 1.0, 0.1))
    found = {"p50": p50, "p1": p1, "p0_1": p0_1, "min": slack.min()}
    return {name: round(float(value), 1) for name, value in found.items()}


def find_faults(log: Log) -> list[dict[str, Any]]:
    """Every fault in order: tick, name, where, and the state it led to."""
    state, tick = log["/tonus/state"], log["/tonus/timing"]["tick"]
    fault = state["fault"].astype(np.int64)
    places = {(event.tick, event.name): event.where for event in log.events()}
    found = []
    for index in np.flatnonzero((fault != 0) & (np.diff(fault, prepend=0) != 0)):
        name = Fault(int(fault[index])).name.lower()
        number = int(state["fault_where"][index])
        where = places.get((int(tick[index]), name), "" if number < 0 else str(number))
        reaction = State(int(state["state"][index])).name
        found.append({"tick": int(tick[index]), "name": name, "where": where, "reaction": reaction})
    return found


def missed_in(log: Log, *states: State) -> tuple[int, int]:
    """Ticks missed in these states: by our own making, and by the host."""
    timing = log["/tonus/timing"]
    chosen = np.isin(log["/tonus/state"]["state"], states)
    own, host = (
        np.diff(timing[name].astype(np.int64), prepend=0)[chosen].sum()
        for name in ("missed_own", "missed_host")
    )
    return int(own), int(host)


def percentiles(values: NDArray[Any]) -> dict[str, float] | None:
    """p50, p99, p99_9 and max of values (n,), in their unit to one decimal; None without any."""
    if not len(values):
        return None
    p50, p99, p99_9 = np.percentile(values, (50.0, 99.0, 99.9))
    return {
        "p50": round(float(p50), 1),
        "p99": round(float(p99), 1),
        "p99_9": round(float(p99_9), 1),
        "max": round(float(values.max()), 1),
    }


def truth_at_cycles(log: Log, field: str) -> Array | None:
    """The truth at the cycles' times (n, ...), linearly between its records; None outside a lab."""
    if TRUTH not in log or not len(log[TRUTH]):
        return None
    values = np.asarray(log[TRUTH][field], dtype=np.float64)
    there, here = log.times(TRUTH), log.times("/tonus/timing")
    # Relative times: a float64 holds UTC in ns only to 256 ns.
    x, xp = (here - there[0]).astype(np.float64), (there - there[0]).astype(np.float64)
    flat = values.reshape(len(values), -1)
    columns = [np.interp(x, xp, column) for column in flat.T]
    return np.stack(columns, axis=1).reshape(len(here), *values.shape[1:])


def tensions(log: Log) -> Array:
    """Cable tensions (n, 8) in N at the cycles: true in a lab, measured otherwise."""
    true = truth_at_cycles(log, "tension")
    return np.asarray(log["/tonus/tension"]["measured"]) if true is None else true


def _tracking(log: Log, active: NDArray[np.bool_]) -> float | None:
    position = truth_at_cycles(log, "position")
    if position is None or not active.any():
        return None
    error = (position - log["/tonus/pose"]["desired_position"])[active]
    return float(np.sqrt((error**2).sum(axis=1).mean()))


def _tension_error(log: Log, running: NDArray[np.bool_]) -> float | None:
    true = truth_at_cycles(log, "tension")
    if true is None or not running.any():
        return None
    error = (true - log["/tonus/tension"]["reference"])[running]
    return float(np.sqrt((error**2).mean()))


def _contact_peak(log: Log) -> float | None:
    true = TRUTH in log and len(log[TRUTH])
    force = log[TRUTH]["contact_force"] if true else log["/tonus/wrench"]["contact"]
    return float(np.abs(force).max()) if len(force) else None


def _range(values: NDArray[Any]) -> dict[str, float] | None:
    if not values.size:
        return None
    return {"min": float(values.min()), "max": float(values.max())}


def _last(values: NDArray[Any]) -> int:
    return int(values[-1]) if len(values) else 0


def _blame(fault: dict[str, Any]) -> str:
    return f"{fault['name']} at {fault['where']}" if fault["where"] else str(fault["name"])


def _seed(log: Log) -> int | None:
    seed = log.metadata.get("seed", "")
    return int(seed) if seed.lstrip("-").isdigit() else None
