"""The way through a run: what each state waits for, what counts as a fault, and how the tensions
grow and shrink on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from config.schema.control import Control
from drivers.process_image import AxisCommand, AxisState, ProcessImage
from runtime.envelope import Envelope
from runtime.referencing import Referencing
from runtime.sensing import Sensing
from runtime.states import TRANSITIONS, Event, Fault, Operator, State

_FAULTS = (int(AxisState.FAULT), int(AxisState.FAULT_REACTION_ACTIVE))
_CABLE_GONE = (
    Fault.DRIVE_LOST,
    Fault.DRIVE_FAULT,
    Fault.CELL_LOST,
    Fault.CELL_BAD,
    Fault.IMPLAUSIBLE_DRIVE,
    Fault.IMPLAUSIBLE_CELL,
    Fault.SLACK_CABLE,
)
MOVING = (State.PRETENSION, State.HOLD, State.ACTIVE, State.SAFE_STOP)


@njit(cache=True)
def _broken_axis(
    state: NDArray[np.uint8],
    age: NDArray[np.uint16],
    fresh: int,
    faults: tuple[int, int],
    wanted: int,
) -> int:
    """The first axis in a fault state, or (``wanted`` not negative) not in the state it was brought
    to although its word is fresh; -1 for none."""
    for i in range(state.shape[0]):
        if state[i] == faults[0] or state[i] == faults[1]:
            return i
        if wanted >= 0 and age[i] <= fresh and state[i] != wanted:
            return i
    return -1


@njit(cache=True)
def _first_set(values: NDArray[np.uint8]) -> int:
    for i in range(values.shape[0]):
        if values[i]:
            return i
    return -1


@dataclass(frozen=True)
class Levels:
    """Tension bounds and pretension of a tick, N."""

    low: float
    high: float
    level: float


class Sequence:
    """The state machine at work: `step` follows at most one event a tick, faults first."""

    def __init__(
        self, control: Control, sensing: Sensing, referencing: Referencing, envelope: Envelope
    ) -> None:
        self._control, self._settings = control, control.sequence
        self._sensing, self._referencing, self._envelope = sensing, referencing, envelope
        self._period = control.rates.period
        self._entered = 0
        self._ready_at = 0.0
        self._resetting = False
        self._not_a_number = False
        self.state = State.OFF
        self.elapsed = 0.0
        """s in this state"""
        self.fault, self.where = Fault.NONE, -1
        self.reason = ""
        """why referencing refused, in words"""
        self.enabled = False
        """every drive has been in Operation Enabled since arming"""
        self.referenced = False
        self.load = 0.0
        """N, what the platform would be pushed away with if it were let go now"""
        self._lower_s = self._settings.lower_s
        self._waited, self._lowering = 0.0, False
        self._tightness = 0.0
        self._straightness = 0.0
        """how far tensions had grown when a stop came, 0 to 1, on the way to each level"""

    def step(
        self, image: ProcessImage, tick: int, operator: Operator, *, finite: bool = True
    ) -> bool:
        """Returns whether the state changed. ``finite``: whether the last estimate was a number."""
        self.elapsed = (tick - self._entered) * self._period
        if self.state is State.SAFE_STOP and self._waits():
            self._waited += self._period
        if not finite:
            operator, self._not_a_number = Operator.ESTOP, True
        event = self._watch(image, operator) or self._arrive(image)
        if event is None:
            return False
        before, self.state = self.state, TRANSITIONS[self.state, event]
        if event is Event.RESET and before is State.FAULT:
            self.fault, self.where = Fault.NONE, -1
            self._resetting, self._not_a_number = True, False
        if self.state is before:
            return False
        self._entered, self.elapsed = tick, 0.0
        self._waited, self._lowering = 0.0, False
        if self.state is State.REFERENCING:
            self._resetting = self.referenced = False
            self._referencing.reset()
            self._envelope.reset()
        elif self.state is State.PRETENSION:
            self.referenced = True
        elif self.state is State.FAULT:
            self._resetting = False
        if self.state in (State.REFERENCING, State.STANDBY, State.FAULT):
            self.enabled = False
        return True

    def plan_stop(self, lower_s: float) -> None:
        """How long the way down to the cradle takes."""
        self._lower_s = lower_s

    @property
    def stop_time(self) -> float:
        """s into a stop, not counting what it waited, or in this state."""
        return self.elapsed - self._waited

    @property
    def stop_ends(self) -> float:
        """`stop_time` at which the drives are disabled."""
        return 2.0 * self._settings.stop_s + self._lower_s

    def _waits(self) -> bool:
        """At a standstill under a load: lowered into the cradle with it, or let go, the platform
        would be thrown aside. It holds until the load is taken away, if that is soon and if it has
        the cables to."""
        settings = self._settings
        if self._lowering or self.stop_time < settings.stop_s:
            return False
        able = self.referenced and self.fault is not Fault.CONTACT_LIMIT and not self.descending
        loaded = self.load > settings.release_load and self._waited < settings.hold_s
        self._lowering = not (able and loaded)
        return not self._lowering

    @property
    def carrying(self) -> NDArray[np.bool_]:
        """(8,) cables that may be asked for tension."""
        present = self._sensing.present
        if self.fault in _CABLE_GONE and 0 <= self.where < len(present):
            present = present.copy()
            present[self.where] = False
        return present

    @property
    def descending(self) -> bool:
        """A stop without all eight cables: weight and damping only, no place to keep."""
        return self.state is State.SAFE_STOP and not self.carrying.all()

    @property
    def axis_command(self) -> AxisCommand:
        if self.state is State.SAFE_STOP:
            stopping = self.enabled and not self._given_up
            return AxisCommand.ENABLE if stopping else AxisCommand.DISABLE
        if self.state in (State.REFERENCING, State.PRETENSION, State.HOLD, State.ACTIVE):
            return AxisCommand.ENABLE
        return AxisCommand.RESET_FAULT if self._resetting else AxisCommand.DISABLE

    @property
    def regulating(self) -> bool:
        """In control of the platform, and not only of single cables."""
        if self.state is State.SAFE_STOP:
            return self.referenced and self.stop_time < self.stop_ends
        return self.state in MOVING

    @property
    def straightening(self) -> float:
        """Share of the referencing tension asked of each cable on its own; negative for none."""
        if not self.enabled:
            return -1.0
        if self.state is State.REFERENCING:
            rise = 0.5 * self._settings.referencing_settle_s
            self._straightness = min(1.0, (self.elapsed - self._ready_at) / rise)
            return self._straightness
        if self.state is State.SAFE_STOP:
            return self._straightness * max(0.0, 1.0 - self.elapsed / self._settings.stop_s)
        return -1.0

    @property
    def levels(self) -> Levels:
        """Full from HOLD on, growing in PRETENSION, shrinking at the end of a stop."""
        tension, settings = self._control.tension, self._settings
        share = 1.0
        if self.state is State.PRETENSION:
            share = min(1.0, self.elapsed / settings.pretension_s)
        elif self.state is State.SAFE_STOP:
            share = min(self._tightness, self._left)
        if self.state is not State.SAFE_STOP:
            self._tightness = share
        if self.descending:
            return Levels(tension.slack, settings.descent_tension, tension.referencing)
        return Levels(
            tension.slack + share * (tension.min - tension.slack),
            tension.referencing + share * (tension.max - tension.referencing)
            if self.state is State.SAFE_STOP
            else tension.max,
            tension.referencing + share * (tension.pre - tension.referencing),
        )

    @property
    def _left(self) -> float:
        """Share of the tensions' way down, at the end of a stop, that is still to go."""
        left = (self.stop_ends - self.stop_time) / self._settings.stop_s
        return min(max(left, 0.0), 1.0)

    @property
    def stiffness_cap(self) -> float:
        """A stop because of contact is a soft one; any other keeps the platform on its way, and
        softens with the tensions once it lies in the cradle."""
        law = self._control.stiffness
        if self.state is not State.SAFE_STOP:
            return law.maximum
        if self.fault is Fault.CONTACT_LIMIT or self.fault in _CABLE_GONE:
            return law.minimum
        return law.minimum + self._left * (law.base - law.minimum)

    @property
    def _given_up(self) -> bool:
        """A stop disables the drives at its end, or early when there was no reference."""
        ends = self.stop_ends if self.referenced else self._settings.stop_s
        return self.stop_time >= ends

    def _watch(self, image: ProcessImage, operator: Operator) -> Event | None:
        if operator is Operator.ESTOP:
            fault = Fault.NOT_FINITE if self._not_a_number else Fault.EMERGENCY_STOP
            if self.state is State.FAULT:
                return None
            return self._raise(fault, -1, Event.ESTOP)
        if self.state is not State.FAULT and self.fault is Fault.NONE:
            event = self._defect(image)
            if event is not None:
                return event
        return Event(operator) if operator is not Operator.NONE else None

    def _defect(self, image: ProcessImage) -> Event | None:
        sensing, axes, cells = self._sensing, image.axes, image.cells
        if self.state is not State.OFF or self.elapsed > self._settings.enable_timeout_s:
            axis = sensing.lost_axis()
            if axis >= 0:
                odd = sensing.implausible_axes[axis]
                return self._raise(Fault.IMPLAUSIBLE_DRIVE if odd else Fault.DRIVE_LOST, axis)
            cell = sensing.lost_cell()
            if cell >= 0:
                odd = sensing.implausible_cells[cell]
                return self._raise(Fault.IMPLAUSIBLE_CELL if odd else Fault.CELL_LOST, cell)
        armed = self.enabled and self.axis_command is AxisCommand.ENABLE
        axis = _broken_axis(
            axes["state"],
            axes["age"],
            self._control.freshness.measurement_ticks,
            _FAULTS,
            int(AxisState.OPERATION_ENABLED) if armed else -1,
        )
        if axis >= 0 and not self._resetting:
            return self._raise(Fault.DRIVE_FAULT, axis)
        cell = _first_set(cells["status"])
        if cell >= 0:
            return self._raise(Fault.CELL_BAD, cell)
        if self.state in MOVING and self._envelope.fault is not Fault.NONE:
            return self._raise(self._envelope.fault, self._envelope.where)
        return None

    def _raise(self, fault: Fault, where: int, event: Event = Event.FAULT) -> Event:
        self.fault, self.where = fault, where
        return event

    def _arrive(self, image: ProcessImage) -> Event | None:
        """What the present state has come to by itself."""
        settings = self._settings
        if self.state is State.OFF:
            return self._tare(image)
        if self.state is State.REFERENCING:
            return self._reference(image)
        if self.state is State.PRETENSION:
            lifted = settings.lift_s + 1.0 / settings.reference_slew
            done = self.elapsed >= settings.pretension_s + lifted
            return Event.TENSIONED if done else None
        if self.state is State.SAFE_STOP and self._given_up:
            silent = image.axes["age"] > self._control.freshness.stale_stop_ticks
            off = image.axes["state"] != AxisState.OPERATION_ENABLED
            if (off | silent).all():
                clean = self.fault is Fault.NONE
                return Event.STOPPED if clean else Event.STOPPED_BY_FAULT
        return None

    def _tare(self, image: ProcessImage) -> Event | None:
        sensing = self._sensing
        sensing.collect_tare(image)
        if sensing.tare_time < self._settings.tare_s:
            return None
        sensing.apply_tare(self._settings.tare)
        beyond = np.abs(sensing.tare) > self._settings.tare_limit
        if beyond.any():
            return self._raise(Fault.CELL_BAD, int(beyond.argmax()))
        return Event.TARED

    def _reference(self, image: ProcessImage) -> Event | None:
        settings, sensing = self._settings, self._sensing
        if not self.enabled:
            ready = image.axes["state"] == AxisState.OPERATION_ENABLED
            if ready.all():
                self.enabled, self._ready_at = True, self.elapsed
            elif self.elapsed > settings.enable_timeout_s:
                return self._raise(Fault.ENABLE_TIMEOUT, int((~ready).argmax()))
            return None
        since = self.elapsed - self._ready_at - settings.referencing_settle_s
        if since >= 0.0:
            self._referencing.collect(image, sensing.angle, sensing.tension)
        if since < settings.referencing_average_s:
            return None
        self.reason = self._referencing.conclude(self._control.tension.referencing)
        if self.reason:
            return self._raise(Fault.REFERENCING_FAILED, -1)
        return Event.REFERENCED
