"""One cable torn at one pose, or broken otherwise, and how the robot stops: at rest, or in motion
past the pose.

A motion runs through the pose along the line to the torn cable's frame anchor, there at the speed
at which the envelope begins to slow the reference, and turns back: towards the anchor first, then
away from it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tests.forked import forked
from tests.loop import QUICK, ClosedLoop, Trace, configured
from tonus.config.schema.scenario import Path, Reference, Waypoint
from tonus.runtime.states import Fault, Operator, State, StopMode
from tonus.sim.plant import Plant

CABLES = 8

Motion = Literal["rest", "towards", "away"]
Place = tuple[float, float, float]
MOTIONS: tuple[Motion, ...] = ("rest", "towards", "away")
GRID: tuple[Place, ...] = tuple(
    (x, y, z) for x, y, z in product((-0.15, 0.0, 0.15), (-0.15, 0.0, 0.15), (-0.06, 0.0, 0.12))
)
"""m: 60 % of the workspace box, but for the lower layer, since the table is at -0.10 m"""
REACH = 0.05
"""m to either side of the pose that a motion goes"""
LATER = 0.3
"""s after which the speed has to fall"""
LONGEST = 20.0
"""s after the break that a stop may take, a passive one that never stands included"""
WATCHED = 2.0
"""s in which a fault has to be found; a robot that finds none goes on"""
_APPROACH = 0.8
"""s to the beginning of a motion"""
_STILL = 0.02
"""m/s and rad/s below which a platform is at rest"""


@dataclass(frozen=True)
class Before:
    """A case: which cable, where and in what motion. Cables count from 0."""

    home: Place
    """m, the pose"""
    cable: int
    motion: Motion
    speed_at_break: float
    """m/s, positive towards the torn cable's anchor"""
    tension_at_break: float
    """N, of the torn cable"""


@dataclass(frozen=True)
class Stopped(Before):
    """What came of it. Times are s after the break."""

    peak_speed: float
    """m/s, of the platform's origin"""
    peak_at: float
    later_speed: float
    """m/s, largest from `LATER` on"""
    peak_turning: float
    """rad/s"""
    peak_tension: float
    """N, of any cable"""
    found_after: float | None
    """s; none if nothing was found"""
    fault: str
    where: int
    given_up: tuple[int, ...]
    """cables that are not used any more in the end"""
    mode: str
    """of the stop, the last one"""
    ended_after: float | None
    """s to FAULT; none if it was not reached"""
    rest: Place
    """m, where the platform is in the end"""
    at_rest: bool

    named: bool
    """`Fault.CABLE_TORN` was found at the cable, as the first fault or after it"""


Breaking = Callable[[Plant, int], object]
"""what breaks at a cable"""


def tear(plant: Plant, cable: int) -> None:
    plant.cut_cable(cable)


def motion_past(robot_anchor: Iterable[float], home: Place, cruise: float) -> Path:
    """To one side of ``home``, through it towards the anchor (m) at ``cruise`` m/s, and back."""
    way = np.array(tuple(robot_anchor)) - home
    side = REACH * way / np.linalg.norm(way)
    # The peak of a minimum-jerk motion is 15/8 of its mean speed.
    across = 1.875 * 2.0 * REACH / cruise
    near, far = tuple(-side), tuple(side)
    return Path(
        kind="path",
        waypoints=(
            Waypoint(position=near, duration=_APPROACH),
            Waypoint(position=far, duration=across),
            Waypoint(position=near, duration=across),
        ),
    )


def crossing(reference: Path, motion: Motion) -> float:
    """s of scenario time at which a motion passes the pose."""
    approach, there, back = (point.duration for point in reference.waypoints)
    if motion == "towards":
        return approach + 0.5 * there
    return approach + there + 0.5 * back


class Torn:
    """A robot in HOLD at a pose, from which every case begins."""

    def __init__(self, home: Place, robot: dict[str, Any] | None = None) -> None:
        """``robot``: overrides of the shipped one."""
        overrides = QUICK | {"robot.home": list(home), "control.sequence.lift_s": 3.0}
        overrides |= robot or {}
        config, scenario = configured("hold", overrides)
        self.home = home
        self._anchors = config.robot.geometry.frame
        envelope = config.control.envelope
        cruise = envelope.speed_limit * envelope.speed_warning
        self._motions = [motion_past(anchor, home, cruise) for anchor in self._anchors]
        others: list[Reference] = list(self._motions)
        self._loop = ClosedLoop(config, scenario, others=others)
        self._loop.until(State.HOLD)
        self._loop.run(0.3)

    def cases(
        self, cable: int, motions: tuple[Motion, ...] = MOTIONS, breaking: Breaking = tear
    ) -> Iterator[Stopped]:
        """One broken cable in each motion; the robot here stays in HOLD."""
        if "rest" in motions:
            yield forked(lambda: self._break(cable, "rest", breaking))
        moving = tuple(motion for motion in motions if motion != "rest")
        if moving:
            yield from forked(lambda: self._move(cable, moving, breaking))

    def pushed(self, cable: int, force: float, breaking: Breaking = tear) -> Stopped:
        """At rest under a push of ``force`` N away from the cable's anchor, which tightens it."""

        def push() -> Stopped:
            way = np.array(self._anchors[cable]) - self._loop.plant.position
            away = -force * way / np.linalg.norm(way)
            self._loop.plant.defects.push(tuple(away), rise=0.5)
            self._loop.run(1.5)
            return self._break(cable, "rest", breaking)

        return forked(push)

    def again(self, cable: int, other: int, after: float) -> Stopped:
        """A cable torn at rest, and an ``other`` one ``after`` s: what comes of that one."""

        def twice() -> Stopped:
            tear(self._loop.plant, cable)
            self._loop.run(after)
            return self._break(other, "rest", tear)

        return forked(twice)

    def _move(self, cable: int, motions: tuple[Motion, ...], breaking: Breaking) -> list[Stopped]:
        loop, found = self._loop, []
        loop.tick(select=cable + 2)
        loop.tick(Operator.START)
        for motion in motions:
            time = crossing(self._motions[cable], motion)
            while float(loop.cycle.record.state.scenario_time) < time:
                loop.tick()
                assert loop.state in (State.HOLD, State.ACTIVE), loop.cycle.sequence.fault.name
            found.append(forked(partial(self._break, cable, motion, breaking)))
        return found

    def _break(self, cable: int, motion: Motion, breaking: Breaking) -> Stopped:
        loop = self._loop
        plant = loop.plant
        way = np.array(self._anchors[cable]) - plant.position
        speed = float(plant.velocity @ way / np.linalg.norm(way))
        tension = float(plant.tension[cable])
        loop.forget()
        breaking(plant, cable)
        for tick in range(round(LONGEST * 1000.0)):
            loop.tick()
            if tick > WATCHED * 1000.0 and loop.cycle.sequence.fault is Fault.NONE:
                break
            if loop.state is State.FAULT and self._still():
                break
        before = Before(self.home, cable, motion, round(speed, 4), round(tension, 1))
        named = loop.cycle.sequence.faults.at(Fault.CABLE_TORN, cable)
        return _outcome(loop.trace, before, named, self._still())

    def _still(self) -> bool:
        plant = self._loop.plant
        fastest = max(np.linalg.norm(plant.velocity), np.linalg.norm(plant.angular_velocity))
        return bool(fastest < _STILL)


def _outcome(trace: Trace, before: Before, named: bool, still: bool) -> Stopped:
    truth, state = trace.truth, trace.cycle["state"]
    speeds = np.linalg.norm(truth["velocity"], axis=1)
    peak = int(speeds.argmax())
    faults: NDArray[np.uint8] = state["fault"]
    first, ended = _first(faults != Fault.NONE), _first(state["state"] == State.FAULT)
    x, y, z = np.round(truth["position"][-1], 3).tolist()
    return Stopped(
        **vars(before),
        peak_speed=round(float(speeds[peak]), 3),
        peak_at=round(1e-3 * (peak + 1), 3),
        later_speed=round(float(speeds[round(LATER * 1000.0) :].max()), 3),
        peak_turning=round(float(np.linalg.norm(truth["angular_velocity"], axis=1).max()), 2),
        peak_tension=round(float(truth["tension"].max()), 1),
        found_after=None if first is None else round(1e-3 * first, 3),
        fault=Fault(int(faults[first or 0])).name,
        where=int(state["fault_where"][first or 0]),
        given_up=tuple(np.flatnonzero(state["failed"].any(axis=0)).tolist()),
        named=named,
        mode=StopMode(int(state["stop_mode"].max())).name,
        ended_after=None if ended is None else round(1e-3 * ended, 3),
        rest=(x, y, z),
        at_rest=still,
    )


def _first(happened: NDArray[np.bool_]) -> int | None:
    """Index of the first that is true."""
    return int(happened.argmax()) if happened.any() else None


__all__ = ["CABLES", "GRID", "LATER", "LONGEST", "MOTIONS", "Motion", "Place", "Stopped", "Torn"]
