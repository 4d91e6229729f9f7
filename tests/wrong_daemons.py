"""Daemons that are changed in mid-run: what a supervisor has to find."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.supervised import DRIVES, REPORT_MS, Run
from tonus.config.schema.supervisor import Requirement
from tonus.drivers.exchange import Exchange
from tonus.runtime.control.allocation import Allocation
from tonus.runtime.control.passivity import Limiter
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.daemon import Daemon
from tonus.runtime.safety.faults import Faults
from tonus.runtime.states import State
from tonus.runtime.supervisor.supervisor import Supervisor
from tonus.tools.campaign.observed import Observed
from tonus.tools.run.supervision import Overheard

AXIS = 2
Change = Callable[[pytest.MonkeyPatch], None]


def after(owner: type, name: str, change: Callable[..., Any]) -> Change:
    """``change(result, *arguments)`` takes the place of what a method gives."""
    original = getattr(owner, name)

    def changed(*arguments: Any) -> Any:
        return change(original(*arguments), *arguments)

    return lambda patch: patch.setattr(owner, name, changed)


def instead(owner: type, name: str, change: Any) -> Change:
    return lambda patch: patch.setattr(owner, name, change)


def blind(patch: pytest.MonkeyPatch) -> None:
    """The daemon finds no fault any more."""
    patch.setattr(Faults, "add", lambda *_, **__: False)


def both(*changes: Change) -> Change:
    def all_of_them(patch: pytest.MonkeyPatch) -> None:
        for change in changes:
            change(patch)

    return all_of_them


def anew(change: Callable[[], Change]) -> Change:
    """For a change that remembers: another one in each run."""

    def made(patch: pytest.MonkeyPatch) -> None:
        change()(patch)

    return made


def angles(change: Callable[[Any, float], Any]) -> Change:
    """Of what the exchange takes for drum angles (n,) rad, and the s since the change began; the
    first are as they were."""

    def made() -> Change:
        begun: list[Any] = []

        def changed(_: Any, exchange: Any, tick: int) -> None:
            table = exchange._axis_table
            if not begun:
                begun.extend((tick, table["angle"].copy()))
            first, at_first = begun
            moved = change(table["angle"] - at_first, (tick - first) * 1e-3)
            table["angle"] = at_first + moved

        return after(Exchange, "fill", changed)

    return anew(made)


def told(word: int, *axes: int) -> Change:
    """The exchange gives these drives a controlword of its own, and the record goes on."""

    def changed(result: tuple[Any, Any], *_: Any) -> tuple[Any, Any]:
        words = list(result[0])
        for axis in axes:
            words[axis] = word
        return words, result[1]

    return after(Exchange, "commands", changed)


def without_power(*axes: int) -> Change:
    """They shut down."""
    return told(0x06, *axes)


def in_quick_stop(*axes: int) -> Change:
    """They hold their motors by themselves."""
    return told(0x02, *axes)


def torque_on_the_bus(change: Callable[[Any], Any]) -> Change:
    def changed(result: tuple[Any, Any], *_: Any) -> tuple[Any, Any]:
        words, torques = result
        return words, change(torques.copy())

    return after(Exchange, "commands", changed)


def torque_in_control(change: Callable[[Any], Any]) -> Change:
    def changed(_: None, cycle: ControlCycle, image: Any, *rest: Any) -> None:
        del cycle, rest
        image.commands["torque"] = change(image.commands["torque"].copy())

    return after(ControlCycle, "act", changed)


class EverySecond:
    """The sign of one torque, in every second tick; ``first``: of which the supervisor sees the
    last before it looks, or the other."""

    def __init__(self, first: int) -> None:
        self.count = first

    def __call__(self, torques: Any) -> Any:
        self.count += 1
        return opposite(torques) if self.count % 2 else torques


class Frozen:
    """Keeps the first value."""

    def __init__(self) -> None:
        self.value: Any = None

    def __call__(self, value: Any) -> Any:
        self.value = value if self.value is None else self.value
        return self.value


def opposite(torques: Any) -> Any:
    torques[AXIS] = -torques[AXIS]
    return torques


def slack(torques: Any) -> Any:
    torques[AXIS] = 0
    return torques


def without(axis: int) -> Callable[[Any], Any]:
    """No torque at an axis."""

    def changed(torques: Any) -> Any:
        torques[axis] = 0
        return torques

    return changed


def exchanged(torques: Any) -> Any:
    torques[[2, 6]] = torques[[6, 2]]
    return torques


def stiff(_: float, limiter: Limiter, *__: Any) -> float:
    limiter.value = 6000.0
    return limiter.value


def raises(*_: Any) -> None:
    raise RuntimeError("changed")


UPPER = np.arange(8) < 4


class Wrong(NamedTuple):
    """Torques with references that are wrong too, and what holds until the last drive has lost the
    heartbeat."""

    state: State
    torques: tuple[float, float]
    """N at the cables, of the upper axes and the lower"""
    references: tuple[float, float]
    found: Requirement
    longest_ms: float
    speed: float
    """m/s at most"""
    tension: float
    """N at most"""
    failed: bool = False
    """every cable is recorded as given up"""
    passive: bool = False
    """in a passive stop, whose references are the record's own"""


def stopped_in_time(wrong: Wrong, run: Run, seen: Observed) -> None:
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert {number for number, _ in run.said} == {wrong.found}
    until = (seen.truth_ns > run.changed_ns) & (seen.truth_ns <= max(run.stopped_ns.values()))
    assert run.slowest_ms - REPORT_MS <= wrong.longest_ms
    assert np.linalg.norm(seen.truth["velocity"][until], axis=1).max() <= wrong.speed
    assert seen.truth["tension"][until].max() <= wrong.tension


AT_ONCE: dict[str, tuple[Change, set[Requirement]]] = {
    "the daemon stands still": (instead(Daemon, "_tick", lambda *_: None), {Requirement.TICK}),
    "the supervisor is gone": (instead(Supervisor, "step", lambda *_: None), set()),
    "nothing is recorded": (
        instead(Overheard, "publish", lambda *_: None),
        {Requirement.TICK},
    ),
    "torques frozen on the bus": (anew(lambda: torque_on_the_bus(Frozen())), {Requirement.FROZEN}),
    "torques frozen in control": (anew(lambda: torque_in_control(Frozen())), {Requirement.FROZEN}),
    "a sign wrong on the bus": (torque_on_the_bus(opposite), {Requirement.COMMAND_LOGGED}),
    "a sign wrong on the bus in each even tick": (
        anew(lambda: torque_on_the_bus(EverySecond(0))),
        {Requirement.COMMAND_LOGGED},
    ),
    "a sign wrong on the bus in each odd tick": (
        anew(lambda: torque_on_the_bus(EverySecond(1))),
        {Requirement.COMMAND_LOGGED},
    ),
    "no torque for one axis on the bus": (
        torque_on_the_bus(slack),
        {Requirement.COMMAND_LOGGED},
    ),
    "K_eq without its limiter": (after(Limiter, "__call__", stiff), {Requirement.STIFFNESS}),
}

"""With the requirements that are found broken, where the drives' frames are read."""


def tensed(_: None, allocation: Allocation, *__: Any) -> None:
    allocation.reference[:] = 240.0


class Tightened:
    """References that rise by 0.2 N in each tick, so slowly that no torque saturates."""

    def __init__(self) -> None:
        self.reference: Any = None

    def __call__(self, _: None, allocation: Allocation, *__: Any) -> None:
        first = allocation.reference.copy() if self.reference is None else self.reference
        self.reference = np.minimum(first + 0.2, 230.0)
        allocation.reference[:] = self.reference


class Later(NamedTuple):
    """What is wrong has to show first. Longest times and the requirement are of drives whose frames
    are read."""

    change: Change
    longest_ms: float
    """to the last drive"""
    requirement: Requirement
    speed: float
    """m/s of the platform that is not exceeded, and"""
    tension: float
    """N of any cable"""


LATER: dict[str, Later] = {
    "tensions far beyond their bound, no fault found": Later(
        both(blind, after(Allocation, "distribute", tensed)), 25.0, Requirement.OPPOSED, 0.8, 600.0
    ),
    "a sign wrong in control, no fault found": Later(
        both(blind, torque_in_control(opposite)), 40.0, Requirement.OPPOSED, 0.8, 100.0
    ),
    "no torque for an upper axis in control, no fault found": Later(
        both(blind, torque_in_control(without(2))), 75.0, Requirement.OPPOSED, 0.45, 100.0
    ),
    "no torque for a lower axis in control, no fault found": Later(
        both(blind, torque_in_control(without(5))), 80.0, Requirement.OPPOSED, 0.6, 100.0
    ),
    "two torques exchanged in control, no fault found": Later(
        both(blind, torque_in_control(exchanged)), 45.0, Requirement.OPPOSED, 0.75, 170.0
    ),
}

CONTRADICTED: dict[str, Later] = {
    "drum angles that drift by 4 rad/s, no fault found": Later(
        both(blind, angles(lambda moved, s: moved + 4.0 * s)),
        *(27.0, Requirement.MEASURED_LOGGED, 0.65, 60.0),
    ),
    "drum angles that stand still, no fault found": Later(
        both(blind, angles(lambda moved, _: 0.0 * moved)),
        *(55.0, Requirement.MEASURED_LOGGED, 0.75, 60.0),
    ),
    "each drum angle is that of the next axis, no fault found": Later(
        both(blind, angles(lambda moved, _: np.roll(moved, 1))),
        *(45.0, Requirement.MEASURED_LOGGED, 0.6, 60.0),
    ),
    "two drives have no power, no fault found": Later(
        both(blind, without_power(0, 4)), 45.0, Requirement.DISARMED, 0.6, 60.0
    ),
    "one drive has no power, no fault found": Later(
        both(blind, without_power(5)), 45.0, Requirement.DISARMED, 0.6, 60.0
    ),
}
"""By frames with which a record does not agree."""
