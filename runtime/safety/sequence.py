"""The way through a run: what each state waits for, what counts as a fault, and how the tensions
grow and shrink on the way."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tonus.config.schema.control import Control
from tonus.config.schema.robot import Robot
from tonus.drivers.process_image import AxisCommand, AxisState, ProcessImage
from tonus.runtime.control.referencing import Referencing
from tonus.runtime.control.sensing import FAULT_STATES, NOT_ENABLED, Sensing
from tonus.runtime.safety.envelope import Envelope
from tonus.runtime.safety.faults import PASSIVE, Faults
from tonus.runtime.safety.isolation import Isolation
from tonus.runtime.safety.straightening import Straightening
from tonus.runtime.safety.witness import Witness
from tonus.runtime.states import ARMED, TRANSITIONS, Event, Fault, Operator, State, StopMode

FEWEST = 5
"""cables with which a descent is planned; with fewer the pose is not known for long"""
MOVING = (State.PRETENSION, State.HOLD, State.ACTIVE, State.SAFE_STOP)
_REGULAR = (State.HOLD, State.ACTIVE)
_ENABLING = (State.REFERENCING, State.PRETENSION, State.HOLD, State.ACTIVE)


@njit(cache=True)
def _broken_axis(
    state: NDArray[np.uint8],
    age: NDArray[np.uint16],
    fresh: int,
    faults: tuple[int, int],
    wanted: int,
    start: int,
) -> int:
    """The first axis from ``start`` on in a fault state, or (``wanted`` not negative) not in the
    state it was brought to although its statusword is fresh; -1 for none."""
    for i in range(start, state.shape[0]):
        if state[i] == faults[0] or state[i] == faults[1]:
            return i
        if wanted >= 0 and age[i] <= fresh and state[i] != wanted:
            return i
    return -1


@njit(cache=True)
def _first_set(values: NDArray[np.uint8], start: int) -> int:
    for i in range(start, values.shape[0]):
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
        self,
        control: Control,
        sensing: Sensing,
        referencing: Referencing,
        envelope: Envelope,
        isolation: Isolation,
        witness: Witness,
        robot: Robot,
    ) -> None:
        self._control, self._settings = control, control.sequence
        self._sensing, self._referencing, self._envelope = sensing, referencing, envelope
        self._isolation, self._witness = isolation, witness
        self._radius = robot.drum_radius
        self._period = control.rates.period
        self._entered = 0
        self._ready_at = 0.0
        """s into referencing when the drives were enabled"""
        self._straight = Straightening(control)
        self._resetting = False
        self.state = State.OFF
        self.elapsed = 0.0
        """s in this state"""
        self.faults = Faults(robot)
        """since the last reset"""
        self.stop_mode = StopMode.NONE
        self._mode_at, self._released_at = 0.0, -1.0
        """s into the state at which the mode began, and the stop let go; -1 for not"""
        self._standing, self._loose = 0.0, False
        """s for which all drums have stood; whether they have been let go entirely"""
        self._slow = 0.0
        """s for which they have been slow, in a passive stop"""
        self._lowest = math.inf
        """m, least height above the cradle since a descent has settled"""
        self.reason = ""
        """why referencing refused, or what control raised, in words"""
        self.enabled = False
        """every drive has been in Operation Enabled since arming"""
        self.referenced = False
        self.load = 0.0
        """N, what the platform would be pushed away with if it were let go now"""
        self.aside = 0.0
        """N of it, level"""
        self._aside_before = 0.0
        """and before the platform was down"""
        self.height = 0.0
        """m, of the platform above its cradle"""
        self.missed = 0.0
        """N of the scaled wrench that the last plan of a descent does not deliver"""
        self._most_missed = control.stop.unsupported * robot.platform.mass * robot.gravity
        self._unsupported_s = 0.0
        self._lower_s = self._settings.lower_s
        self._waited, self._lowering = 0.0, False
        tension = control.tension
        self._full = Levels(
            tension.slack + (tension.min - tension.slack),
            tension.max,
            tension.referencing + (tension.pre - tension.referencing),
        )
        self._tightness = 0.0
        """how far tensions had grown when a stop came, 0 to 1"""

    def step(
        self, image: ProcessImage, tick: int, operator: Operator, *, finite: bool = True
    ) -> bool:
        """Returns whether the state changed. ``finite``: whether the last estimate was a number."""
        self.elapsed = (tick - self._entered) * self._period
        if self.state is State.SAFE_STOP and self._waits():
            self._waited += self._period
        event = self._watch(image, operator, finite) or self._arrive(image)
        before = self.state
        if event is not None:
            self.state = TRANSITIONS[self.state, event]
        if event is Event.RESET and before is State.FAULT:
            self.faults.reset()
            self._resetting = True
        if self.state is State.SAFE_STOP:
            self._choose_stop()
        if self.state is before:
            return False
        self._entered, self.elapsed = tick, 0.0
        self._waited, self._lowering = 0.0, False
        self._mode_at = 0.0
        if self.state is not State.SAFE_STOP:
            self.stop_mode = StopMode.NONE
            self._released_at, self._loose = -1.0, False
        if self.state is State.REFERENCING:
            self._resetting = self.referenced = False
            self._referencing.reset()
            self._envelope.reset()
            self._isolation.reset()
            self._witness.reset()
        elif self.state is State.PRETENSION:
            self.referenced = True
        elif self.state is State.FAULT:
            self._resetting = False
        if self.state in (State.REFERENCING, State.STANDBY, State.FAULT):
            self.enabled = False
        return True

    def rehearse(self, image: ProcessImage) -> None:
        """Ask each question about devices that an ordinary tick needs no answer to, so that none is
        compiled in the tick of a fault."""
        self._sensing.lost_axis()
        self._sensing.lost_cell()
        _broken_axis(image.axes["state"], image.axes["age"], 0, FAULT_STATES, -1, 0)
        _first_set(image.cells["status"], 0)

    @property
    def fault(self) -> Fault:
        """The first one since the last reset."""
        return self.faults.first

    @property
    def where(self) -> int:
        """Its axis or cell, -1 for none."""
        return self.faults.where

    def _choose_stop(self) -> None:
        """The best stop whose assumptions hold, and never a better one again."""
        faults = self.faults
        lost = int(faults.failed.sum())
        blind = any(faults.has(cause) for cause in PASSIVE) or faults.at(Fault.LENGTH_DRIFT, -1)
        fewest = self._control.stop.fewest_doubted if faults.contradicted else FEWEST
        known = self.referenced and not blind and len(faults.failed) - lost >= fewest
        if not known or self._hangs or self._is_held() or self._is_unsupported(lost):
            wanted = StopMode.PASSIVE
        elif lost or not self._sensing.present.all():
            wanted = StopMode.DESCENT
        else:
            wanted = StopMode.ON_PATH
        if wanted > self.stop_mode:
            self.stop_mode, self._mode_at = wanted, self.elapsed
            self._standing, self._lowest = 0.0, math.inf
            self._slow = 0.0
        if self.elapsed - self._mode_at >= self._control.stop.settle_s:
            self._lowest = min(self._lowest, self.height)

    def abandon(self, reason: str, tick: int) -> None:
        """Control raised for ``reason``: no further event is handled, the daemon ends the run."""
        self.faults.add(Fault.CONTROL_FAILED, -1)
        self.reason = reason
        self.state = State.SAFE_STOP if self.state in ARMED else State.FAULT
        self.stop_mode = StopMode.PASSIVE if self.state is State.SAFE_STOP else StopMode.NONE
        self._entered, self.elapsed = tick, 0.0

    def stop_before_ticks(self) -> None:
        """An emergency stop while the bus is brought up: no tick follows."""
        self.faults.add(Fault.EMERGENCY_STOP, -1)
        self.state = State.FAULT

    @property
    def passive_share(self) -> float:
        """Share of the passive tension, 1 down to 0 once all drums stand, or of a descent's last
        tensions once it has landed; negative before that, and on the path."""
        if self.stop_mode is not StopMode.PASSIVE and not self.releasing:
            return -1.0
        if not self.referenced:
            return self._straight.share * max(0.0, 1.0 - self.elapsed / self._settings.stop_s)
        if self._released_at < 0.0:
            return 1.0
        return max(0.0, 1.0 - (self.elapsed - self._released_at) / self._settings.stop_s)

    @property
    def releasing(self) -> bool:
        """A stop without a path lets go: tensions ease off, and each drum damps by itself until
        the platform lies, since cables at once without a torque would throw it or let it fall."""
        return self.state is State.SAFE_STOP and self._released_at >= 0.0

    def _stand(self) -> None:
        """Count how long all drums have stood; a passive stop releases them when that is long
        enough, a descent when it has landed."""
        stop = self._control.stop
        faults = self.faults
        pulling = faults.drums_trusted & faults.drums_obedient & ~faults.torn
        fastest = float((np.abs(self._sensing.rate * pulling) * self._radius).max())
        self._standing = self._standing + self._period if fastest < stop.rest_speed else 0.0
        if self.releasing:
            if not self._loose and self.passive_share <= 0.0:
                self._loose, self._standing = True, 0.0
            return
        if self.stop_mode is not StopMode.PASSIVE:
            # Whatever seems to push it: by whose measurement, only cells could tell.
            lowered = self.stop_ends - (0.0 if self.descending else self._settings.stop_s)
            if self.height <= stop.landed and self.stop_time >= lowered:
                self._released_at = self.elapsed
            return
        self._slow = self._slow + self._period if fastest < stop.passive_speed else 0.0
        rests = self._standing >= stop.rest_s or self._slow >= max(self._lower_s, stop.rest_s)
        late = self.elapsed - self._mode_at >= stop.passive_s
        if self.referenced and (rests or late):
            self._released_at = self.elapsed

    @property
    def _ends_a_fault(self) -> bool:
        """On its path, but for a fault: in the cradle no cell is relied on any more."""
        return self.stop_mode is StopMode.ON_PATH and self.faults.first is not Fault.NONE

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
        able = self.stop_mode is StopMode.ON_PATH and not self.faults.has(Fault.CONTACT_LIMIT)
        loaded = self.load > settings.release_load and self._waited < settings.hold_s
        self._lowering = not (able and loaded)
        return not self._lowering

    @property
    def carrying(self) -> NDArray[np.bool_]:
        """(n,) cables that may be asked for tension."""
        faults, present = self.faults, self._sensing.present
        return present & ~faults.failed if faults.count else present

    @property
    def sound(self) -> NDArray[np.bool_]:
        """(n,) cables among them whose measurements are usable in this tick."""
        faults, sensing = self.faults, self._sensing
        return sensing.sound & ~faults.failed if faults.count else sensing.sound

    @property
    def descending(self) -> bool:
        """A stop without all cables: weight and damping only, no position is held."""
        return self.stop_mode is StopMode.DESCENT

    @property
    def axis_command(self) -> AxisCommand:
        if self.state is State.SAFE_STOP:
            stopping = self.enabled and not self._given_up
            return AxisCommand.ENABLE if stopping else AxisCommand.DISABLE
        if self.state in _ENABLING:
            return AxisCommand.ENABLE
        return AxisCommand.RESET_FAULT if self._resetting else AxisCommand.DISABLE

    @property
    def regulating(self) -> bool:
        """In control of the platform, and not only of single cables."""
        if self.state is State.SAFE_STOP:
            if self.stop_mode is StopMode.PASSIVE or self.releasing:
                return False
            return not self._given_up
        return self.state in MOVING

    @property
    def straightening(self) -> float:
        """Share of the referencing tension asked of each cable on its own; negative for none."""
        if not self.enabled or self.state is not State.REFERENCING:
            return -1.0
        return self._straight.grow(self.elapsed - self._ready_at)

    @property
    def waits_for(self) -> list[int]:
        """Cables that are slack, for which the others wait before lengths are referenced."""
        return self._straight.waits_for if self.state is State.REFERENCING else []

    @property
    def levels(self) -> Levels:
        """Full from HOLD on, growing in PRETENSION, shrinking at the end of a stop."""
        if self.state in _REGULAR:
            self._tightness = 1.0
            return self._full
        tension, settings = self._control.tension, self._settings
        share = 1.0
        if self.state is State.PRETENSION:
            share = min(1.0, self.elapsed / settings.pretension_s)
        elif self.state is State.SAFE_STOP:
            share = min(self._tightness, self._left)
        if self.state is not State.SAFE_STOP:
            self._tightness = share
        if self.descending:
            stop = self._control.stop
            return Levels(stop.least_tension, stop.most_tension, stop.passive_tension)
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
        if self.stop_mode is not StopMode.ON_PATH or self.faults.has(Fault.CONTACT_LIMIT):
            return law.minimum
        return law.minimum + self._left * (law.base - law.minimum)

    @property
    def _given_up(self) -> bool:
        """A stop disables the drives at its end, or early when there was no reference."""
        if self.stop_mode <= StopMode.ON_PATH and not self.releasing:
            return self.stop_time >= self.stop_ends
        if not self.referenced:
            return self.passive_share <= 0.0
        stop = self._control.stop
        longest = self._released_at + stop.landing_s
        if self.stop_mode is StopMode.PASSIVE:
            longest = max(longest, self._mode_at + stop.passive_s)
        late = self.elapsed - longest >= self._settings.stop_s
        return self._loose and (self._standing >= stop.rest_s or late)

    @property
    def _hangs(self) -> bool:
        """A descent that does not come down, or rises: something it relies on is wrong. Let go from
        up there, the platform would fall."""
        stop = self._control.stop
        if self.stop_mode is not StopMode.DESCENT or self.releasing or self.height <= stop.landed:
            return False
        if self.height > self._lowest + stop.rise:
            return True
        late = self.stop_time - self.stop_ends
        return late >= (0.0 if self._standing >= stop.rest_s else stop.landing_s)

    def _is_unsupported(self, lost: int) -> bool:
        """A descent with several cables lost whose plans have missed a large part of the weight for
        a while: what is left lets the platform turn, faster and faster, where drums that only damp
        let it swing below the cables that hold it."""
        stop = self._control.stop
        missing = self.stop_mode is StopMode.DESCENT and lost > 1 and self.height > stop.landed
        if missing and self.missed > self._most_missed and not self.releasing:
            self._unsupported_s += self._period
        else:
            self._unsupported_s = 0.0
        return self._unsupported_s >= stop.unsupported_s

    def _is_held(self) -> bool:
        """A stop on its path is down, and is held aside as it was not before: by the cradle. The
        path leads elsewhere, and would drag the platform out in the end."""
        stop = self._control.stop
        if self.stop_mode is not StopMode.ON_PATH:
            return False
        if not self._lowering or self.height > stop.landed:
            self._aside_before = self.aside
        return self.aside > self._aside_before + stop.load_free

    def _watch(self, image: ProcessImage, operator: Operator, finite: bool) -> Event | None:
        """Every fault in every state; the first since the last reset is an event."""
        if self.state is State.FAULT:
            return Event(operator) if operator is Operator.RESET else None
        if operator is Operator.ESTOP:
            self.faults.add(Fault.EMERGENCY_STOP, -1)
            return Event.ESTOP
        clean = self.faults.first is Fault.NONE
        if not finite:
            self.faults.add(Fault.NOT_FINITE, -1)
        if image.unguarded and self.state in ARMED:
            self.faults.add(Fault.RELAY_SILENT, -1)
        if image.supervisor_ignored and self.state in ARMED:
            self.faults.add(Fault.SUPERVISOR_IGNORED, -1)
        self._examine_devices(image)
        if self.enabled and self.state is not State.STANDBY:
            self.faults.add(*self._isolation.disobedient(self.stop_mode, self.faults.failed))
        if self.state in MOVING:
            # Without excluding the cable: what a stop needs of it, it knows already.
            cable = self._witness.misread
            if cable >= 0:
                self.faults.add(Fault.LENGTH_DRIFT, cable, exclude=False)
            if self.stop_mode is not StopMode.PASSIVE:
                self._examine_motion()
        if clean and self.faults.first is not Fault.NONE:
            return Event.FAULT
        return Event(operator) if operator is not Operator.NONE else None

    def _examine_devices(self, image: ProcessImage) -> None:
        """Silence, faults and defects that drives and cells show."""
        sensing, faults = self._sensing, self.faults
        alarm = sensing.alarm
        if not alarm or (alarm == NOT_ENABLED and not self.enabled):
            return
        axes, cells = image.axes, image.cells
        if self.state is not State.OFF or self.elapsed > self._settings.enable_timeout_s:
            axis = -1
            while (axis := sensing.lost_axis(axis + 1)) >= 0:
                odd = sensing.implausible_axes[axis]
                faults.add(Fault.IMPLAUSIBLE_DRIVE if odd else Fault.DRIVE_LOST, axis)
            cell = -1
            while (cell := sensing.lost_cell(cell + 1)) >= 0:
                odd = sensing.implausible_cells[cell]
                faults.add(Fault.IMPLAUSIBLE_CELL if odd else Fault.CELL_LOST, cell)
        armed = self.enabled and self.axis_command is AxisCommand.ENABLE
        fresh = self._control.freshness.measurement_ticks
        wanted, axis = int(AxisState.OPERATION_ENABLED) if armed else -1, -1
        states, ages = axes["state"], axes["age"]
        while not self._resetting:
            axis = _broken_axis(states, ages, fresh, FAULT_STATES, wanted, axis + 1)
            if axis < 0:
                break
            faults.add(Fault.DRIVE_FAULT, axis)
        cell = -1
        while (cell := _first_set(cells["status"], cell + 1)) >= 0:
            faults.add(Fault.CELL_BAD, cell)

    def _examine_motion(self) -> None:
        """A cable that contradicts the others comes before a bound that is met: it may be why."""
        if not self.descending:
            self.faults.add(*self._isolation.found(self._sensing.tension))
        elif (cable := self._isolation.misread) >= 0:
            self.faults.add(Fault.LENGTH_DRIFT, cable, exclude=False)
        self.faults.add(self._envelope.fault, self._envelope.where)

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
        if self.stop_mode > StopMode.ON_PATH or self._ends_a_fault:
            self._stand()
        if self.state is State.SAFE_STOP and self._given_up:
            silent = image.axes["age"] > self._control.freshness.stale_stop_ticks
            off = image.axes["state"] != AxisState.OPERATION_ENABLED
            if (off | silent).all():
                clean = self.faults.first is Fault.NONE
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
            self.faults.add(Fault.CELL_BAD, int(beyond.argmax()))
            return Event.FAULT
        return Event.TARED

    def _reference(self, image: ProcessImage) -> Event | None:
        settings, sensing = self._settings, self._sensing
        if not self.enabled:
            ready = image.axes["state"] == AxisState.OPERATION_ENABLED
            if ready.all():
                self.enabled, self._ready_at = True, self.elapsed
                self._straight.begin()
            elif self.elapsed > settings.enable_timeout_s:
                self.faults.add(Fault.ENABLE_TIMEOUT, int((~ready).argmax()))
                return Event.FAULT
            return None
        time = self.elapsed - self._ready_at
        since = self._straight.settled(time)
        if since >= 0.0:
            self._referencing.collect(image, sensing.angle, sensing.tension)
        elif slack := self._straight.take_up(time, sensing.tension):
            return self._refuse(f"it is still slack after {settings.take_up_s:g} s", slack)
        if since < settings.referencing_average_s:
            return None
        reason = self._referencing.conclude(self._control.tension.referencing)
        return self._refuse(reason, self._referencing.astray) if reason else Event.REFERENCED

    def _refuse(self, reason: str, cables: list[int]) -> Event:
        self.reason = reason
        for cable in cables or [-1]:
            self.faults.add(Fault.REFERENCING_FAILED, cable)
        return Event.FAULT
