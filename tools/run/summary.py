"""summary.json: what a script wants to know about a run, computed from its log alone."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.runtime.states import Fault, State
from tonus.tools.log import Log

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
    indicators: Indicators | None = None,
) -> Summary:
    """The keys of summary.json. What a run did not give is None: accuracy without a lab's truth,
    latencies without a cycle.

    Tracking is judged in ACTIVE; tension and stiffness in HOLD and ACTIVE; contact, timing and
    faults over the whole log. ``indicators``: taken from its pieces already, where the whole log
    does not fit into memory.
    """
    if indicators is None:
        log.load([topic for topic in (*_NEEDED, TRUTH) if topic in log])
    timing, state = log["/tonus/timing"], log["/tonus/state"]
    faults = find_faults(log)
    phase = state["state"]
    active = phase == State.ACTIVE
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
        **(indicators or _indicators(log)).told(),
        "faults": faults,
        "seed": _seed(log),
        "log": log.path.name,
    }


class Indicators:
    """Accuracy and extremes of a run, summed up from consecutive pieces of it."""

    def __init__(self) -> None:
        self._tracking, self._tension_error = _MeanSquare(), _MeanSquare()
        self._k_eq, self._tension = _Range(), _Range()
        self._contact, self._speed = _Range(), _Range()

    def add(self, log: Log) -> None:
        phase = log["/tonus/state"]["state"]
        running, active = np.isin(phase, _RUNNING), phase == State.ACTIVE
        tension = tensions(log)
        true = TRUTH in log and len(log[TRUTH]) > 0
        if true:
            position = truth_at_cycles(log, "position")
            error = (position - log["/tonus/pose"]["desired_position"])[active]
            self._tracking.add((error**2).sum(axis=1))
            self._tension_error.add((tension - log["/tonus/tension"]["reference"])[running] ** 2)
        force = log[TRUTH]["contact_force"] if true else log["/tonus/wrench"]["contact"]
        self._contact.add(np.abs(force))
        self._k_eq.add(log["/tonus/stiffness"]["k_eq"][running])
        self._tension.add(tension[running])
        self._speed.add((log["/tonus/pose"]["velocity"] ** 2).sum(axis=1))

    @property
    def speed(self) -> float:
        """Highest estimated one, m/s."""
        span = self._speed.told()
        return float(np.sqrt(span["max"])) if span else 0.0

    def told(self) -> Summary:
        """Their keys of summary.json."""
        contact = self._contact.told()
        return {
            "tracking_rmse_m": self._tracking.root(),
            "tension_rmse_n": self._tension_error.root(),
            "k_eq_n_per_m": self._k_eq.told(),
            "tension_n": self._tension.told(),
            "contact_peak_n": None if contact is None else contact["max"],
        }


def _indicators(log: Log) -> Indicators:
    found = Indicators()
    found.add(log)
    return found


class _MeanSquare:
    def __init__(self) -> None:
        self._total, self._count = 0.0, 0

    def add(self, squares: Array) -> None:
        self._total += float(squares.sum())
        self._count += squares.size

    def root(self) -> float | None:
        return float(np.sqrt(self._total / self._count)) if self._count else None


class _Range:
    def __init__(self) -> None:
        self._ends: list[float] = []

    def add(self, values: NDArray[Any]) -> None:
        if values.size:
            self._ends += [float(values.min()), float(values.max())]

    def told(self) -> dict[str, float] | None:
        ends = self._ends
        return {"min": min(ends), "max": max(ends)} if ends else None


def _host(timing: NDArray[Any], active: NDArray[np.bool_]) -> Summary:
    """What else the cycles say about time, as far as the log has it: older ones do not."""
    names = timing.dtype.names or ()
    found: Summary = {"compute_us": percentiles(timing["compute_us"])}
    found["bus_us"] = percentiles(timing["bus_us"]) if "bus_us" in names else None
    found["after_us"] = percentiles(timing["after_us"]) if "after_us" in names else None
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
    places: dict[tuple[int, str], str] = {}
    for event in log.events():
        # Of several in one tick the first is the reason for the stop.
        places.setdefault((event.tick, event.name), event.where)
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


def _last(values: NDArray[Any]) -> int:
    return int(values[-1]) if len(values) else 0


def _blame(fault: dict[str, Any]) -> str:
    return f"{fault['name']} at {fault['where']}" if fault["where"] else str(fault["name"])


def _seed(log: Log) -> int | None:
    seed = log.metadata.get("seed", "")
    return int(seed) if seed.lstrip("-").isdigit() else None
