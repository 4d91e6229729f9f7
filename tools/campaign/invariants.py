"""What no run in the lab may do, whatever is wrong with it: one implementation for campaign, tests
and logs.

Each check gives the first place where its bound was broken, and by how much at most. Truth is what
the plant did; a command is what the cycle recorded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonus.config.loader import load_bounds
from tonus.config.schema.bounds import Bounds
from tonus.runtime.recording.taps import Level
from tonus.runtime.states import ARMED, Fault, Operator, State
from tonus.tools.campaign.again import first_difference
from tonus.tools.campaign.allowance import Allowance, Limits, for_torn_cables
from tonus.tools.campaign.observed import FAULTED, GOOD, Observed, of_log
from tonus.tools.campaign.strikes import NS
from tonus.tools.campaign.supervised import reach_ns, stops
from tonus.tools.log.log import Log

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
_AT_COMMAND = (State.HOLD, State.ACTIVE)
_REGULATING = (State.PRETENSION, State.HOLD, State.ACTIVE, State.SAFE_STOP)
_ROUNDING = 1.0 + 1e-9
_FEWEST_CARRYING = 3
"""cables that can hold a weight at rest, but for poses in one plane with two anchors"""


@dataclass(frozen=True)
class Violation:
    """A bound that was broken."""

    invariant: str
    at_s: float
    """s on the clock of the records, where it was broken first"""
    value: float
    """the worst of it"""
    bound: float
    text: str

    def __str__(self) -> str:
        return f"{self.invariant} at {self.at_s:.3f} s: {self.text}"


def within_bounds(
    run: Observed | Log,
    *,
    allowance: Allowance = for_torn_cables,
    bounds: Bounds | None = None,
    replayed: bool = False,
) -> list[Violation]:
    """Every invariant that a run breaks, in the order of time; a good run gives none.

    ``replayed``: the recorded inputs also go through a fresh cycle, which takes as long as the
    run's own computation did, and every output is compared bit for bit. Raises `ToolError` for a
    log that cannot be judged.
    """
    if isinstance(run, Log):
        run = of_log(run)
    checked = bounds or load_bounds()
    limits = allowance(run)
    found = [violation for check in CHECKS for violation in check(run, checked)]
    found += _motion(run, checked, limits)
    found += _wrongly_stopped(run, found)
    if replayed:
        found += _replay(run)
    return sorted(found, key=lambda violation: violation.at_s)


def _commands(run: Observed, _: Bounds) -> Iterator[Violation]:
    """Tensions asked for lie in [0, T_max], at command in [T_min, T_max]; torques in the drives'
    reach; all are numbers."""
    reference = run.cycle["tension"]["reference"]
    tension, reach = run.config.control.tension, run.config.robot.torque_limit
    low = np.where(np.isin(run.state, _AT_COMMAND), tension.min, 0.0)[:, None]
    wrong = ~((reference >= low / _ROUNDING) & (reference <= tension.max * _ROUNDING))
    yield from _worst(
        "commanded_tension", run.cycle_ns, wrong, reference, tension.max, "N commanded of cable"
    )
    torque = np.abs(run.cycle["drives"]["torque_command"])
    wrong = ~(torque <= reach * _ROUNDING)
    yield from _worst(
        "commanded_torque", run.cycle_ns, wrong, torque, float(reach.max()), "N m commanded of axis"
    )


def _stale(run: Observed, _: Bounds) -> Iterator[Violation]:
    """No torque without a fresh encoder behind it; outside a stop none without a fresh cell."""
    drives = run.cycle["drives"]
    fresh = run.config.control.freshness.measurement_ticks
    torque = drives["torque_command"]
    cells = run.cycle["force_cells"]["age"][:, : torque.shape[1]]
    stopping = (run.state == State.SAFE_STOP)[:, None]
    stale = (drives["age"] > fresh) | ((cells > fresh) & ~stopping)
    yield from _worst(
        "stale_torque", run.cycle_ns, stale & (torque != 0.0), np.abs(torque), 0.0, "N m on axis"
    )


def _stiffness(run: Observed, _: Bounds) -> Iterator[Violation]:
    """K_eq in its bounds from the first regulated tick on, and rising as passivity allows."""
    law, period = run.config.control.stiffness, run.config.control.rates.period
    k_eq = run.cycle["stiffness"]["k_eq"]
    there = np.isin(run.state, _REGULATING) & (k_eq != 0.0)
    wrong = there & ~((k_eq >= law.minimum / _ROUNDING) & (k_eq <= law.maximum * _ROUNDING))
    yield from _worst("stiffness", run.cycle_ns, wrong, k_eq, law.maximum, "N/m of K_eq")
    rise = np.diff(k_eq, prepend=k_eq[:1])
    allowed = np.roll(run.cycle["energy"]["rise_bound"], 1) * period
    both = there & np.roll(there, 1)
    both[:1] = False
    wrong = both & (rise > allowed + 1e-6)
    yield from _worst(
        "stiffness_rise", run.cycle_ns, wrong, rise / period, law.rise_rate, "N/m/s of K_eq"
    )


def _motion(run: Observed, bounds: Bounds, limits: Limits | None) -> Iterator[Violation]:
    """True speed, tension, contact, and falls. Where all power was cut on purpose the platform
    sinks as fast as its drums let it."""
    times, truth = run.truth_ns, run.truth
    tension = bounds.tension * run.config.control.tension.max
    top = bounds.speed
    if limits is not None:
        tension, top = max(tension, limits.tension), max(top, limits.speed)
    pull = truth["tension"]
    yield from _worst("tension", times, ~(pull <= tension), pull, tension, "N in cable")
    powered = ~unpowered(run)
    speed = np.where(powered, np.linalg.norm(truth["velocity"], axis=1), 0.0)
    yield from _worst("speed", times, ~(speed <= top), speed, top, "m/s")
    yield from _not_falling(run, bounds, speed)
    yield from _free_fall(run, bounds, powered)
    yield from _contact(run, bounds)


def _not_falling(run: Observed, bounds: Bounds, speed: Floats) -> Iterator[Violation]:
    """From a while after each fault on, no speed that was not reached before. One that did no harm
    at first counts once more when it is found: the stop that follows moves the platform. A push
    does work as long as it lasts, and its end is a step of force as its beginning is. With power on
    fewer cables than can carry it the platform sinks on its drums' friction until it lies."""
    times = run.truth_ns
    wrong = np.zeros(len(speed), bool)
    allowed = np.full(len(speed), np.inf)
    delay = round((bounds.falling_from + bounds.settle) * NS)
    faults = sorted({strike.at_ns for strike in run.strikes})
    if not faults:
        return
    worse = np.diff(run.cycle["state"]["stop_mode"].astype(np.int8), prepend=0) > 0
    found = run.cycle_ns[worse & (run.cycle_ns > faults[0])]
    pushes = [push for strike in run.strikes for push in strike.pushes]
    faults = sorted({*faults, *found.tolist(), *(time for push in pushes for time in push)})
    ends = np.append(np.searchsorted(times, faults[1:]), len(times))
    for at, end in zip(faults, ends, strict=False):
        first, last = np.searchsorted(times, [faults[0], at + delay])
        if last >= end or first >= last:
            continue
        allowed[last:end] = max(bounds.quiet_speed, float(speed[first:last].max()))
        wrong[last:end] = ~(speed[last:end] <= allowed[last:end])
    for at, end in pushes:
        wrong[slice(*np.searchsorted(times, [at, end]))] = False
    wrong &= _axes(run) - cut_off(run) >= _FEWEST_CARRYING
    bound = float(allowed[wrong.argmax()]) if wrong.any() else 0.0
    yield from _worst("speed_rises", times, wrong, speed, bound, "m/s, reached long after a fault")


def _free_fall(run: Observed, bounds: Bounds, powered: Flags) -> Iterator[Violation]:
    """Never longer than a moment."""
    times, settings = run.truth_ns, bounds.free_fall
    if len(times) < 2:
        return
    steps = np.diff(times) / NS
    rate = np.diff(run.truth["velocity"][:, 2]) / steps
    falls = np.concatenate(([False], rate < -settings.share * run.config.robot.gravity))
    falls &= powered
    starts, ends = _stretches(falls)
    lengths = (times[ends - 1] - times[starts - 1]) / NS
    long = lengths >= settings.longest
    if long.any():
        at, worst = int(starts[long.argmax()]), float(lengths.max())
        text = f"{worst * 1e3:.0f} ms of free fall"
        yield Violation("free_fall", float(times[at] / NS), worst, settings.longest, text)


def _contact(run: Observed, bounds: Bounds) -> Iterator[Violation]:
    times, force = run.truth_ns, run.truth["contact_force"]
    limit = run.config.control.envelope.contact_limit
    allowed = np.full(len(times), limit)
    wide = round((bounds.contact.within + bounds.settle) * NS)
    for strike in run.strikes:
        near = (times >= strike.at_ns) & (times <= strike.at_ns + wide)
        allowed[near] = np.maximum(allowed[near], bounds.contact.force)
    wrong = ~(force <= allowed)
    bound = float(allowed[wrong.argmax()]) if wrong.any() else limit
    yield from _worst("contact", times, wrong, force, bound, "N on the contact port")


def unpowered(run: Observed) -> Flags:
    """(m,) times of the truth at which all power was off, and not by control's choice: an emergency
    stop, what is no number, a stop by the supervisor, or every axis `cut_off`."""
    state = run.cycle["state"]
    asked = (state["operator"] == Operator.ESTOP) | (
        np.isin(state["fault"], (Fault.EMERGENCY_STOP, Fault.NOT_FINITE))
        & (state["state"] == State.FAULT)
    )
    reach = reach_ns(run.config)
    for stop in stops(run):
        asked[np.searchsorted(run.cycle_ns, stop.at_ns + reach) :][:1] = True
    off = np.zeros(len(asked), bool)
    now = False
    armed = np.isin(state["state"], tuple(ARMED))
    for index in np.flatnonzero(asked | np.diff(armed, prepend=False)):
        now = bool(asked[index]) or (now and not armed[index])
        off[index:] = now
    found = run.at_truth(off, before=False) | (cut_off(run) == _axes(run))
    return np.asarray(found)


def cut_off(run: Observed) -> NDArray[np.int64]:
    """(m,) axes without STO, supply or a way to the master at each time of the truth. A drive that
    lost its power has it back only after the operator's reset, which no armed robot gets."""
    cut: set[int] = set()
    count = np.zeros(len(run.truth_ns), np.int64)
    for strike in run.strikes:
        cut |= strike.unpowered
        count[run.truth_ns >= strike.at_ns] = len(cut)
    return count


def _axes(run: Observed) -> int:
    return int(run.cycle["drives"]["torque_command"].shape[1])


def _named(run: Observed, bounds: Bounds) -> Iterator[Violation]:
    """A fault has a name: the one that the machine stopped for at once, and each that strikes an
    armed robot within a second, with its place. A cable that is not used any more had its name."""
    state = run.cycle["state"]
    told = {(event.tick, event.name) for event in run.events}
    fault, where = state["fault"], state["fault_where"]
    ticks = run.cycle["timing"]["tick"]
    cables = state["failed"].shape[1]
    for index in np.flatnonzero((fault != 0) & (np.diff(fault, prepend=0) != 0)):
        name = Fault(int(fault[index])).name.lower()
        if (int(ticks[index]), name) not in told:
            yield Violation(
                "unnamed",
                float(run.cycle_ns[index] / NS),
                float(where[index]),
                0.0,
                f"no event reports {name}",
            )
    armed = np.isin(state["state"], tuple(ARMED))
    wait = round((bounds.named_within + bounds.settle) * NS)
    for strike in run.strikes:
        if not strike.named:
            continue
        first, last = np.searchsorted(run.cycle_ns, [strike.at_ns, strike.at_ns + wait])
        # Whoever is switched off meanwhile for another reason need not find out.
        if last >= len(armed) or not armed[max(first - 1, 0) : last].all():
            continue
        struck = sorted(strike.axes | {cell for cell in strike.cells if cell < cables})
        if struck and state["failed"][max(first - 1, 0), struck].all():
            continue
        heard = any(
            strike.at_ns - bounds.settle * NS <= event.time_ns <= strike.at_ns + wait
            and event.level >= Level.WARNING
            and strike.is_named_by(event.where)
            for event in run.events
        )
        if not heard:
            place = ", ".join([*(f"axis {axis}" for axis in sorted(strike.axes)), *strike.places])
            place = place or ", ".join(f"cell {cell}" for cell in sorted(strike.cells))
            text = f"no event within {bounds.named_within:g} s names {place} after {strike.kind}"
            yield Violation("unnamed", strike.at_ns / NS, wait / NS, bounds.named_within, text)


def _wrongly_stopped(run: Observed, broken: list[Violation]) -> Iterator[Violation]:
    """The supervisor stops an armed robot by itself only where a bound is broken by then, whatever
    else is wrong with it: the daemon is right, and its own stop is the better one. Where that has
    taken the torque already, the supervisor takes it of drives that may not have heard of it."""
    for stop in stops(run):
        if stop.state not in ARMED:
            continue
        earlier = [each for each in broken if each.at_s <= stop.at_ns / NS]
        if not any(each.invariant in _OF_THE_ROBOT for each in earlier):
            text = f"the supervisor stopped the robot, no bound was broken by then: {stop.text}"
            yield Violation("supervisor", stop.at_ns / NS, 1.0, 0.0, text)


def _end(run: Observed, _: Bounds) -> Iterator[Violation]:
    """STANDBY or FAULT, with the exit code that the commands promise; and no exception."""
    at = float(run.cycle_ns[-1] / NS) if len(run.cycle_ns) else 0.0
    if run.error:
        yield Violation("exception", at, 1.0, 0.0, run.error)
        return
    if run.cut:
        return
    last = State(int(run.state[-1])) if len(run.state) else State.OFF
    state = run.end.state if run.end is not None else last
    if state not in (State.STANDBY, State.FAULT):
        yield Violation("end", at, float(state), float(State.STANDBY), f"it ended in {state.name}")
    elif run.end is not None:
        right = FAULTED if state is State.FAULT or run.end.fault is not Fault.NONE else GOOD
        if run.end.exit_code != right:
            text = f"exit code {run.end.exit_code} in {state.name}"
            yield Violation("end", at, float(run.end.exit_code), float(right), text)


def _replay(run: Observed) -> Iterator[Violation]:
    found = first_difference(run)
    if found is not None:
        index, signal = found
        text = f"{signal} does not come out again"
        yield Violation("replay", float(run.cycle_ns[index] / NS), 1.0, 0.0, text)


CHECKS: tuple[Callable[[Observed, Bounds], Iterator[Violation]], ...] = (
    _commands,
    _stale,
    _stiffness,
    _named,
    _end,
)

INVARIANTS = (
    "commanded_tension",
    "commanded_torque",
    "stale_torque",
    "stiffness",
    "stiffness_rise",
    "tension",
    "speed",
    "speed_rises",
    "free_fall",
    "contact",
    "unnamed",
    "supervisor",
    "end",
    "exception",
    "replay",
)
"""Names of all, as violations have them."""
_OF_THE_ROBOT = INVARIANTS[: INVARIANTS.index("unnamed")]
"""what it is commanded, and what it does"""


def _stretches(flags: Flags) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First indices of runs of True, and those one behind their last."""
    edges = np.diff(np.concatenate(([False], flags, [False])).astype(np.int8))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


def _worst(
    invariant: str,
    times_ns: NDArray[np.int64],
    wrong: Flags,
    values: NDArray[np.floating],
    bound: float,
    what: str,
) -> Iterator[Violation]:
    """One violation for all that is ``wrong`` (n,) or (n, k): its first time and largest value."""
    if not wrong.any():
        return
    rows = wrong if wrong.ndim == 1 else wrong.any(axis=1)
    first = float(times_ns[rows.argmax()] / NS)
    bad = np.where(wrong, values, -np.inf)
    bad = np.where(wrong & ~np.isfinite(values), np.inf, bad)
    worst = float(bad.max())
    place = "" if wrong.ndim == 1 else f" {int(np.unravel_index(bad.argmax(), bad.shape)[1])}"
    text = f"{worst:.3g} {what}{place}; bound {bound:.3g}"
    yield Violation(invariant, first, worst, bound, text)
