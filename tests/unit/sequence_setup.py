"""The state machine at work, with sensing, referencing, envelope and isolation that say what a test
wants: a tick takes microseconds, and every time is a whole number of ticks."""

from __future__ import annotations

from collections.abc import Sequence as Rows
from types import SimpleNamespace
from typing import Any

import numpy as np

from tonus.config import load
from tonus.drivers.process_image import AxisCommand, AxisState, ProcessImage
from tonus.runtime.control.sensing import DEFECT, FAULTED, NOT_ENABLED, SILENT
from tonus.runtime.safety.sequence import Sequence
from tonus.runtime.states import Fault, Operator, State, StopMode

OVERRIDES = {
    "control.sequence.tare_s": 0.25,
    "control.sequence.tare_limit": 5.0,
    "control.sequence.enable_timeout_s": 0.008,
    "control.sequence.referencing_settle_s": 0.004,
    "control.sequence.referencing_average_s": 0.008,
    "control.sequence.slack_s": 0.0015,
    "control.sequence.take_up_s": 0.0155,
    "control.sequence.pretension_s": 0.016,
    "control.sequence.lift_s": 0.002,
    "control.sequence.reference_slew": 10.0,
    "control.sequence.stop_s": 0.016,
    "control.sequence.lower_s": 0.032,
    "control.sequence.release_load": 10.0,
    "control.sequence.hold_s": 0.02,
    "control.stop.settle_s": 0.008,
    "control.stop.rest_s": 0.008,
    "control.stop.passive_s": 0.064,
    "control.stop.landing_s": 0.016,
    "control.stop.landed": 0.01,
    "control.stop.rise": 0.02,
    "control.stop.unsupported": 0.5,
    "control.stop.unsupported_s": 0.016,
    "control.stop.rest_speed": 0.02,
    "control.stop.passive_speed": 0.15,
    "control.stop.load_free": 15.0,
}
CONFIG, _ = load("config/can.yaml", overrides=OVERRIDES)
CONTROL, ROBOT = CONFIG.control, CONFIG.robot
N = ROBOT.cables
STOP_TICKS = 64
"""of a stop along the path: twice stop_s, and lower_s"""
PRETENSION_TICKS = 118
"""pretension_s, lift_s, and the time that the reference takes: 1 / reference_slew"""

REST_TICKS = 8
"""rest_s, settle_s"""
PASSIVE_TICKS = 64
"""passive_s"""
LANDING_TICKS = 16
"""landing_s, for which drums that were let go may go on moving"""
RELEASE_TICKS = 16
"""stop_s"""
FAST = 10.0
"""rad/s of a drum that a passive stop waits for: 0.2 m/s"""
LOWER_TICKS = 32
"""lower_s"""
HELD_TICKS = 20
"""hold_s"""


def _next(places: set[int], start: int) -> int:
    assert start >= 0
    return min((each for each in places if each >= start), default=-1)


class Way:
    """Drives that obey within a tick. What a test sets is seen in the next tick."""

    def __init__(self) -> None:
        self.lost_axes: set[int] = set()
        self.lost_cells: set[int] = set()
        self.disobedient = self.contradiction = (Fault.NONE, -1)
        self.asked: list[StopMode] = []
        """the modes in which isolation was asked for drums that disobey"""
        self.resets: list[str] = []
        self.collected = self.tared = 0
        self.concluded: list[float] = []
        self.stated: list[Rows[float] | None] = []
        self.refusal = ""
        self.obeying = True
        self.sensing: Any = SimpleNamespace(
            present=np.ones(N, bool),
            sound=np.ones(N, bool),
            alarm=SILENT | FAULTED | NOT_ENABLED | DEFECT,
            rate=np.zeros(N),
            tension=np.full(N, 30.0),
            angle=np.full(N, 0.5),
            tare=np.zeros(N + 1),
            tare_time=0.0,
            implausible_axes=np.zeros(N, bool),
            implausible_cells=np.zeros(N + 1, bool),
            lost_axis=lambda start: _next(self.lost_axes, start),
            lost_cell=lambda start: _next(self.lost_cells, start),
            collect_tare=self._collect_tare,
            apply_tare=self.stated.append,
        )
        referencing: Any = SimpleNamespace(
            reset=lambda: self.resets.append("referencing"),
            collect=self._collect,
            conclude=self._conclude,
            astray=[],
        )
        self.envelope: Any = SimpleNamespace(
            reset=lambda: self.resets.append("envelope"), fault=Fault.NONE, where=-1
        )
        self.isolation: Any = SimpleNamespace(
            reset=lambda: self.resets.append("isolation"),
            disobedient=self._disobedient,
            found=self._found,
            misread=-1,
        )
        self.witness: Any = SimpleNamespace(reset=lambda: self.resets.append("witness"), misread=-1)
        self.image = ProcessImage(N)
        self.image.axes["age"] = self.image.cells["age"] = 0
        self.image.axes["state"] = AxisState.SWITCH_ON_DISABLED
        self.tick = 0
        self.sequence = Sequence(
            CONTROL,
            self.sensing,
            referencing,
            self.envelope,
            self.isolation,
            self.witness,
            ROBOT,
        )

    def _collect_tare(self, image: ProcessImage) -> None:
        assert image is self.image
        self.tared += 1

    def _collect(self, image: ProcessImage, angle: Any, tension: Any) -> None:
        assert image is self.image
        assert angle is self.sensing.angle
        assert tension is self.sensing.tension
        self.collected += 1

    def _conclude(self, tension: float) -> str:
        self.concluded.append(tension)
        return self.refusal

    def _disobedient(self, mode: StopMode, failed: Any) -> tuple[Fault, int]:
        assert failed is self.sequence.faults.failed
        self.asked.append(mode)
        return self.disobedient

    def _found(self, tension: Any) -> tuple[Fault, int]:
        assert tension is self.sensing.tension
        return self.contradiction

    @property
    def state(self) -> State:
        return self.sequence.state

    def step(self, operator: Operator = Operator.NONE, *, finite: bool = True) -> bool:
        before = self.state
        changed = self.sequence.step(self.image, self.tick, operator, finite=finite)
        assert changed is (self.state is not before)
        self.tick += 1
        _ = self.sequence.levels, self.sequence.straightening  # as the cycle does in every tick
        if self.obeying:
            enabled = self.sequence.axis_command is AxisCommand.ENABLE
            state = AxisState.OPERATION_ENABLED if enabled else AxisState.SWITCH_ON_DISABLED
            self.image.axes["state"] = state
        return changed

    def steps(self, count: int, *, after: State | None = None) -> None:
        """All in one state: the present one, unless ``after`` is what the last one leads to."""
        before = self.state
        for number in range(count):
            assert self.state is before, f"{self.state.name} after {number} ticks"
            self.step()
        assert self.state is (before if after is None else after)

    def to(self, state: State) -> Way:
        """From the beginning, by the events and times of a good run."""
        ways = {State.STANDBY: Operator.ARM, State.HOLD: Operator.START}
        self.sensing.tare_time = 0.25
        for _ in range(500):
            if self.state is state:
                return self
            self.step(ways.get(self.state, Operator.NONE))
        raise AssertionError(f"{self.state.name}, not {state.name}")

    def stop(self, state: State = State.ACTIVE) -> Way:
        """Its first tick is over."""
        self.to(state).step(Operator.STOP)
        assert self.state is State.SAFE_STOP
        return self

    def fail(self, *cells: int) -> Way:
        """Cells that report a defect, for a tick."""
        self.image.cells["status"][list(cells)] = 1
        self.step()
        self.image.cells["status"] = 0
        return self


def until(way: Way, mode: StopMode, most: int = 300) -> int:
    return next(count for count in range(most) if way.sequence.stop_mode is mode or way.step())


def enabled(way: Way, most: int = 400) -> int:
    """Ticks until the drives are to be disabled."""
    for count in range(most):
        if way.sequence.axis_command is AxisCommand.DISABLE:
            return count
        way.step()
    raise AssertionError("they never are")


def descent(cable: int = 4) -> Way:
    """At a height above the cradle; a tick of it is over."""
    way = Way().to(State.ACTIVE)
    way.sequence.height = 0.3
    way.fail(cable)
    assert way.sequence.stop_mode is StopMode.DESCENT
    return way


def passive() -> Way:
    way = Way().to(State.ACTIVE)
    way.step(finite=False)
    assert way.sequence.stop_mode is StopMode.PASSIVE
    way.sensing.rate = np.full(N, FAST)
    return way
