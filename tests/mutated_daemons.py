"""Daemons without a part of what keeps the robot safe, or with one that is wrong: what their
supervisor makes of them, alone, and what the robot does meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from tests.supervised import BRIEF, DRIVES, Run, configured
from tests.wrong_daemons import (
    Change,
    Frozen,
    after,
    anew,
    blind,
    both,
    exchanged,
    instead,
    opposite,
    raises,
    stiff,
    torque_in_control,
    torque_on_the_bus,
    without,
)
from tonus.config.loader import load_scenario
from tonus.config.schema.robot_faults import CableCut, MotorWeak
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.control.passivity import Limiter
from tonus.runtime.control.tension import TensionLoop
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.daemon import Daemon
from tonus.runtime.safety.envelope import Envelope
from tonus.runtime.safety.fallback import Fallback
from tonus.runtime.safety.guard import Guard
from tonus.runtime.safety.isolation import Isolation
from tonus.runtime.safety.sequence import Sequence
from tonus.runtime.safety.witness import Witness
from tonus.runtime.states import Event, Fault, State
from tonus.tools.campaign.invariants import within_bounds
from tonus.tools.campaign.observed import Observed

NOTHING = (Fault.NONE, -1)
_BY_THE_PROGRAM = {"unnamed", "supervisor"}
"""not kept by a daemon that finds nothing, and is stopped for it"""
_OF_THE_PLATFORM = {"tension", "speed", "free_fall", "contact"}
NOBODY = property(lambda _: -1)


def frozen_loop() -> Change:
    """Its first torques, whatever is asked of it."""
    frozen = Frozen()

    def kept(finite: bool, loop: TensionLoop, *_: Any, **__: Any) -> bool:
        loop.torque[:] = frozen(loop.torque.copy())
        return finite

    original = TensionLoop.follow

    def follow(loop: TensionLoop, *arguments: Any, **named: Any) -> bool:
        return kept(original(loop, *arguments, **named), loop)

    return instead(TensionLoop, "follow", follow)


def inverted(torque: Any, guard: Guard, rate: Any, *rest: Any) -> Any:
    """The damping and the brake of a passive stop, with the wrong sign."""
    del rate, rest
    return 2.0 * guard._law[0] * guard._radius - torque


def ignoring(event: Event) -> Change:
    return after(Sequence, "_watch", lambda found, *_: None if found is event else found)


@dataclass(frozen=True)
class Mutated:
    """What is wrong, what the supervisor finds, and what the robot does."""

    change: Change
    requirement: Requirement
    longest_ms: float
    """to the last drive"""
    speed: float
    """m/s that the platform does not exceed until then, and"""
    speed_after: float
    """as long as the drives brake, and without power"""
    broken: frozenset[str] = frozenset()
    """bounds of config/bounds.yaml that do not hold until then, and"""
    broken_after: frozenset[str] = frozenset()
    """after it"""
    seldom_after: frozenset[str] = frozenset()
    """those that do not hold after it where the look comes at some instants, and hold at others"""
    speed_braked: float = 0.05
    """as ``speed_after``, of a robot with brakes, and"""
    broken_braked: frozenset[str] = frozenset()
    """as ``broken_after``"""
    stopping: bool = False
    """what is wrong is the daemon's own stop"""
    strikes: tuple[Any, ...] = ()
    """faults of the lab that come with it"""
    told_to_stop: bool = False
    scenario: str = "sine_z"
    at: float = 0.5
    seconds: float = 1.5
    since: Callable[[Observed], int] | None = None
    """ns from which it counts, where what is wrong has no effect at first"""


def touched(seen: Observed) -> int:
    """The contact is beyond what the supervisor allows."""
    return int(seen.truth_ns[seen.truth["contact_force"] > 27.5][0])


SPEED = frozenset({"speed"})
FALL = frozenset({"free_fall", "speed"})
DAEMONS: dict[str, Mutated] = {
    "it stands still": Mutated(
        instead(Daemon, "_tick", lambda *_: None), Requirement.TICK, 25.0, 0.05, 0.7
    ),
    "the fallback is removed, control raises": Mutated(
        both(
            instead(ControlCycle, "act", raises),
            instead(Fallback, "step", lambda *_, **__: None),
        ),
        Requirement.BRAKED,
        25.0,
        0.05,
        0.7,
        stopping=True,
    ),
    "the envelope is removed, in contact": Mutated(
        instead(Envelope, "__call__", lambda *_: None),
        Requirement.CONTACT,
        27.0,
        0.15,
        0.9,
        broken=frozenset({"contact"}),
        broken_after=SPEED,
        speed_braked=0.1,
        scenario="contact_near",
        at=0.1,
        seconds=6.0,
        since=touched,
    ),
    "the isolation is removed, a motor is reversed": Mutated(
        both(
            instead(Isolation, "found", lambda *_: NOTHING),
            instead(Isolation, "disobedient", lambda *_: NOTHING),
            instead(Isolation, "misread", NOBODY),
            instead(Witness, "misread", NOBODY),
        ),
        Requirement.UNEXPLAINED,
        28.0,
        0.1,
        0.8,
        speed_braked=0.5,
        strikes=(MotorWeak(axis=2, gain=-1.0),),
    ),
    "a sign is wrong in control": Mutated(
        both(blind, torque_in_control(opposite)),
        Requirement.OPPOSED,
        36.0,
        0.16,
        0.65,
        speed_braked=0.6,
    ),
    "a sign is wrong in the exchange": Mutated(
        both(blind, torque_on_the_bus(opposite)),
        Requirement.COMMAND_LOGGED,
        25.0,
        0.05,
        0.65,
        speed_braked=0.4,
    ),
    "the tension loop is frozen": Mutated(anew(frozen_loop), Requirement.FROZEN, 25.0, 0.05, 0.7),
    "an order to stop is ignored": Mutated(
        ignoring(Event.STOP), Requirement.ORDERS, 25.0, 0.05, 0.7, told_to_stop=True
    ),
    "a fault is ignored, a cable is cut": Mutated(
        ignoring(Event.FAULT),
        Requirement.OPPOSED,
        28.0,
        0.6,
        1.15,
        broken=frozenset({"commanded_tension"}),
        broken_after=SPEED,
        speed_braked=1.0,
        broken_braked=SPEED,
        strikes=(CableCut(axis=2),),
    ),
    "no fault is looked for, a cable is cut": Mutated(
        blind,
        Requirement.OPPOSED,
        30.0,
        0.6,
        0.95,
        broken_after=SPEED,
        speed_braked=1.0,
        broken_braked=SPEED,
        strikes=(CableCut(axis=2),),
    ),
    "the brake of a passive stop is inverted": Mutated(
        both(instead(ControlCycle, "act", raises), after(Guard, "passive", inverted)),
        Requirement.BRAKED,
        74.0,
        0.1,
        0.35,
        speed_braked=0.2,
        stopping=True,
    ),
    "the limiter of K_eq is removed": Mutated(
        after(Limiter, "__call__", stiff),
        Requirement.STIFFNESS,
        20.0,
        0.05,
        0.95,
        broken=frozenset({"stiffness", "stiffness_rise"}),
        broken_after=FALL,
    ),
    "an upper axis gets no torque": Mutated(
        both(blind, torque_in_control(without(2))),
        Requirement.OPPOSED,
        74.0,
        0.1,
        0.5,
        speed_braked=0.1,
    ),
    "two torques are exchanged": Mutated(
        both(blind, torque_in_control(exchanged)),
        Requirement.OPPOSED,
        44.0,
        0.1,
        0.75,
        seldom_after=frozenset({"free_fall"}),
        speed_braked=0.55,
    ),
}


@dataclass(frozen=True)
class Stopped:
    """What became of it."""

    requirements: frozenset[int]
    found_ms: float
    """to the supervisor's emergency frame, and"""
    stopped_ms: float
    """to the last drive that reports the end of its heartbeat"""
    speed: float
    """m/s of the platform until then, and"""
    speed_after: float
    """after it, without control"""
    tension: float
    """N, until then"""
    broken: frozenset[str]
    """bounds of config/bounds.yaml that did not hold until then, and"""
    broken_after: frozenset[str]
    """those that did not hold later, by the drives' own braking and without power"""
    stopping: bool
    """the daemon had begun a stop by itself before"""
    error: str


BARE, BRAKED = "config/can.yaml", "config/braked.yaml"
"""the paper's robot, and the same with a holding brake on every motor"""


def played(name: str, patch: pytest.MonkeyPatch, robot: str = BARE) -> Stopped:
    """In virtual time, on CAN; until the platform lies where it came down, or hangs."""
    mutated = DAEMONS[name]

    def change() -> None:
        mutated.change(patch)
        lab = run._playing.lab
        assert lab is not None
        for strike in mutated.strikes:
            lab.inject(strike)
        if mutated.told_to_stop:
            run._playing.script.stop()

    config, _ = configured(robot, **BRIEF)
    run = Run(config, load_scenario(mutated.scenario), change, at=mutated.at)
    with patch.context():
        seen = run.play(mutated.seconds)
    patch.undo()
    since = run.changed_ns if mutated.since is None else mutated.since(seen)
    last = max(run.stopped_ns.values()) if len(run.stopped_ns) == len(DRIVES) else seen.truth_ns[-1]
    speed = np.linalg.norm(seen.truth["velocity"], axis=1)
    until = (seen.truth_ns > run.changed_ns) & (seen.truth_ns <= last)
    first_ns = min((round(at * 1e9) for _, at in run.said), default=int(last))
    before = (seen.cycle_ns > run.changed_ns) & (seen.cycle_ns < first_ns)
    # It is left in the middle of a run that may not come to an end by itself.
    judged = within_bounds(replace(seen, error="", cut=True, events=()))
    early = frozenset(each.invariant for each in judged if each.at_s * 1e9 <= last)
    every = frozenset(each.invariant for each in judged)
    return Stopped(
        frozenset(number for number, _ in run.said),
        (first_ns - since) * 1e-6,
        (int(last) - since) * 1e-6 if len(run.stopped_ns) == len(DRIVES) else float("inf"),
        float(speed[until].max(initial=0.0)),
        float(speed[seen.truth_ns > last].max(initial=0.0)),
        float(seen.truth["tension"][until].max(initial=0.0)),
        early - _BY_THE_PROGRAM,
        (every - early) & _OF_THE_PLATFORM,
        State.SAFE_STOP in seen.state[before],
        seen.error,
    )
