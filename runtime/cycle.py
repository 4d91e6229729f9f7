"""The tick. `ControlCycle.step` is a pure function of its own state and its arguments: sensors,
filters, estimator, stiffness law, envelope, distribution, tension loop.

No clock, no input or output, no randomness, nothing that grows. What an operator says and what the
buses report come in as arguments, and the state machine is part of it, so that recorded inputs
reproduce every output bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.control import Control
from tonus.config.schema.operation import Tunable
from tonus.config.schema.robot import Robot
from tonus.config.schema.scenario import Reference
from tonus.config.schema.tracker import Tracker
from tonus.drivers.process_image import AxisCommand, ProcessImage
from tonus.runtime.control.allocation import Allocation
from tonus.runtime.control.controllers import Motion, make_controller
from tonus.runtime.control.controllers.base import norm, rehearse_descent
from tonus.runtime.control.disagreement import Disagreement
from tonus.runtime.control.estimator import Doubts, Estimate, PoseEstimator
from tonus.runtime.control.guide import Guide
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.control.passivity import Limiter
from tonus.runtime.control.referencing import Referencing
from tonus.runtime.control.sensing import Sensing
from tonus.runtime.control.tension import FOLLOWING, TensionLoop
from tonus.runtime.control.tuning import NO_CHANGE, GainChange, Tuning
from tonus.runtime.recording.cycle_writer import CycleWriter
from tonus.runtime.safety.cross_check import CrossCheck
from tonus.runtime.safety.descent import Descent
from tonus.runtime.safety.envelope import Envelope
from tonus.runtime.safety.isolation import Isolation
from tonus.runtime.safety.sequence import Sequence
from tonus.runtime.safety.witness import Witness
from tonus.runtime.signals import Consistency, CycleRecord, Grade
from tonus.runtime.states import ARMED, Operator, State, StopMode

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_MOST_SKIPPED = 100
"""missed ticks in a row that the estimate is carried over: each takes as long as in a tick"""
# Looked up once: a member of an enumeration takes ten times as long as a name (Python 3.11).
_HOLD = State.HOLD
_ACTIVE = State.ACTIVE
_BEARING = (State.HOLD, State.ACTIVE)


class ControlCycle:
    """Everything the robot does in a millisecond."""

    def __init__(
        self,
        robot: Robot,
        control: Control,
        tracker: Tracker,
        reference: Reference,
        others: Iterable[Reference] = (),
        tunable: tuple[Tunable, ...] = (),
    ) -> None:
        """``others`` can be chosen instead of ``reference``, and ``tunable`` parameters changed, by
        their numbers from 1 on."""
        period = control.rates.period
        self._robot, self._control, self._period = robot, control, period
        self._resting = robot.rest[2]
        self.record = CycleRecord(robot.cables)
        self._kinematics = Kinematics(robot.geometry)
        self._sensing = Sensing(robot, control)
        self._envelope = Envelope(
            control.envelope, control.tension, control.stiffness, robot, period
        )
        taut = control.stop.taut_tension
        self._referencing = Referencing(
            robot, control.sequence, Kinematics(robot.geometry), taut, period
        )
        self._isolation = Isolation(robot, control.isolation, control.stop, period)
        self._witness = Witness(robot, control.isolation, tracker, taut, period)
        self.sequence = Sequence(
            control,
            self._sensing,
            self._referencing,
            self._envelope,
            self._isolation,
            self._witness,
            robot,
        )
        self._guide = Guide(robot, control.sequence, control.envelope, reference, period, others)
        self._estimator = PoseEstimator(
            robot, control.estimator, tracker, self._kinematics, period, Doubts.of(control)
        )
        self._cross_check = CrossCheck(
            self._sensing,
            self.sequence,
            self._referencing,
            self._estimator,
            self._isolation,
            self._witness,
        )
        self._controller = make_controller(control.controller, robot, control)
        self.tuning = Tuning(tunable, self._controller.tunable_law, period)
        ratio = self._controller.damping_ratio
        self._limiter = Limiter(control.stiffness, control.passivity, robot, ratio, period)
        self._allocation = Allocation(robot, control, self._controller, self._kinematics)
        self._descent = Descent(robot, control, period)
        self._loop = self._usual_loop = TensionLoop(robot, control.tension_loop, period)
        self._active_loop = self._usual_loop
        if self._controller.tension_loop != control.tension_loop:
            self._active_loop = TensionLoop(robot, self._controller.tension_loop, period)
        self._writer = CycleWriter(
            self.record,
            self._sensing,
            self.sequence,
            self._guide,
            self._estimator,
            self._controller,
            self._limiter,
            self._envelope,
            self._allocation,
            self.tuning,
        )
        self._nobody = np.zeros(robot.cables, dtype=bool)
        self._pulling = np.zeros(robot.cables)
        self._torque = np.zeros(robot.cables)
        """N m, of the last tick"""
        self._last_tick, self._skipped = -1, 0
        self.drums = self._isolation.drums
        self._none = np.zeros(robot.cables)
        self._drum_motion = np.zeros((3, robot.cables))
        """rad/s (n,) that would follow the platform, rad/s and rad/s2 (n,) of the desired motion"""
        self._drum_rate = self._drum_motion[FOLLOWING]
        self._law = 0.0
        self.accepted = False
        """a tracker pose, in the last tick that regulated"""
        self.lean = False
        """As in `tonus.runtime.ports.Recorded`."""
        self._finite = True

    def step(
        self,
        image: ProcessImage,
        tick: int,
        operator: Operator,
        select: int = 0,
        change: GainChange = NO_CHANGE,
    ) -> CycleRecord:
        """One whole tick: `act`, `judge`, then `write`."""
        self.act(image, tick, operator, select, change)
        self.judge(image)
        return self.write(image, tick, operator, select, change)

    def act(
        self,
        image: ProcessImage,
        tick: int,
        operator: Operator,
        select: int = 0,
        change: GainChange = NO_CHANGE,
    ) -> None:
        """From ``image.axes``, ``image.cells`` and ``image.tracker`` to ``image.commands``.
        ``select``: number of a scenario plus one, to be played from its beginning; heeded while
        `selectable`. ``change``: of a tunable parameter; heeded if nothing stands against it."""
        sensing, sequence = self._sensing, self.sequence
        sensing.step(image, tick)
        if select and self.selectable:
            self._guide.select(select - 1)
        if sequence.step(image, tick, operator, finite=self._finite):
            self._enter(sequence.state)
        if change.number:
            self.tuning.ask(change, sequence.state)
        self.tuning.step()
        image.command.fill(int(sequence.axis_command))
        self._skipped = tick - self._last_tick - 1
        self._last_tick = tick
        self._cross_check.begin(
            self._torque,
            self._drum_rate,
            self._allocation.reference,
            self._descent.taking_up,
            skipped=self._skipped != 0,
        )
        self._descent.taking_up[:] = False
        if sequence.passive_share >= 0.0:
            self._give_way(image)
            return
        torque, usable = image.torque, sequence.sound
        if sequence.regulating:
            estimate = self._estimate(image)
            self._regulate(estimate)
            torque[:] = self._drive(estimate, usable)
            if sequence.descending:
                fresh = image.axis.age <= self._control.freshness.measurement_ticks
                damping = sequence.faults.damping & fresh
                following, desired, _ = self._drum_motion
                self._descent.bound(torque, sensing.rate, following, desired, usable, damping)
        elif sequence.straightening >= 0.0:
            straight = sequence.straightening * self._control.tension.referencing
            self._allocation.reference[:] = straight
            torque[:] = self._loop(
                self._allocation.reference,
                sensing.tension,
                self._none,
                sensing.rate,
                usable,
                self._kinematics.lengths,
            )
        else:
            self._allocation.reference[:] = 0.0
            torque[:] = 0.0
        self._torque[:] = torque

    def judge(self, image: ProcessImage) -> None:
        """What the next tick will ask of faults, of the tick that `act` has just been called for:
        the drives need not wait for it."""
        self._cross_check.finish(image)

    def fall_back(self, image: ProcessImage, tick: int) -> None:
        """In place of `act`, from the tick in which that raised on: each drive as in the last tick,
        and the passive stop's torques, by the drums' rates alone."""
        self._sensing.step(image, tick)
        trusted = image.axis.age <= self._control.freshness.measurement_ticks
        image.torque[:] = self._descent.guard.passive(self._sensing.rate, trusted)

    def rehearse(self, image: ProcessImage) -> None:
        """Ask the stages what an ordinary tick needs no answer to, or not by itself, so that
        nothing is compiled in the tick of a fault. For a cycle that is thrown away."""
        self.sequence.rehearse(image)
        self._cross_check.rehearse(image)
        self._allocation.rehearse(self._descent)
        rehearse_descent(self._controller)

    def _give_way(self, image: ProcessImage) -> None:
        """A tick of a passive stop, or of a descent that has landed and lets go."""
        sequence, stop, sensing = self.sequence, self._control.stop, self._sensing
        if sequence.referenced:
            self._referencing.lengths(sensing.angle, sensing.tension, self._skipped)
        fresh = image.axis.age <= self._control.freshness.measurement_ticks
        trusted = sequence.faults.drums_readable & sequence.faults.drums_obedient & fresh
        share = sequence.passive_share
        if share < 0.0 or sequence.axis_command is not AxisCommand.ENABLE:
            trusted[:], share = False, 0.0
        shares = np.where(sequence.faults.torn, 0.0, share)
        if sequence.stop_mode is StopMode.ON_PATH and share == 1.0:
            self._descent.planned[:] = self._allocation.reference
        if sequence.stop_mode is not StopMode.PASSIVE:
            shares *= self._descent.planned / stop.passive_tension
        self._allocation.reference[:] = shares * stop.passive_tension * trusted
        torque = self._descent.guard.passive(sensing.rate, trusted, shares)
        image.torque[:] = self._torque[:] = torque

    def write(
        self,
        image: ProcessImage,
        tick: int,
        operator: Operator,
        select: int = 0,
        change: GainChange = NO_CHANGE,
    ) -> CycleRecord:
        """The record of the tick that `act` has just been called for, with the same arguments: the
        drives need not wait for it."""
        loop, accepted, lean = self._loop, self.accepted, self.lean
        self._writer.tick(image, tick, operator, select, change, loop, accepted=accepted, lean=lean)
        if self.sequence.regulating:
            self._solve_cables()
            self._writer.results(self._law)
        return self.record

    def leave_unwritten(self) -> None:
        """In place of `write`: what a tick without a record has to be watched for too."""
        if self.sequence.regulating:
            self._solve_cables()

    def _solve_cables(self) -> None:
        measured = self._referencing.measured
        self._estimator.solve_cables(measured, recorded=not self.lean)

    @property
    def selectable(self) -> bool:
        """Another scenario may be chosen: nothing moves, and nothing will until a START."""
        state = self.sequence.state
        return state not in ARMED or (state is _HOLD and self._guide.standing)

    @property
    def scenario_time(self) -> float:
        """s of the scenario, or of the lift, that have been played."""
        return self._guide.time

    @property
    def grade(self) -> Grade:
        """The envelope's."""
        return self._envelope.grade

    @property
    def consistency(self) -> Consistency:
        """Whether what is measured fits together."""
        return self._estimator.consistency

    @property
    def disagreement(self) -> Disagreement:
        """Of the tracker with the cables."""
        return self._estimator.disagreement

    @property
    def deficit(self) -> float:
        """N of the wanted wrench that the cables cannot deliver."""
        return self._allocation.distribution.deficit

    @property
    def tare(self) -> Array:
        """(n + 1,) N subtracted from the cells' readings."""
        return self._sensing.tare

    @property
    def forces(self) -> Array:
        """(n + 1,) N, tared and filtered."""
        return np.asarray(self._sensing.filter.value)

    def _enter(self, state: State) -> None:
        self._finite = True
        self._change_loop(self._active_loop if state is _ACTIVE else self._usual_loop)
        if state is State.REFERENCING:
            self._loop.reset()
            self._limiter.reset()
            self._controller.reset()
            self._allocation.reset()
        elif state is State.PRETENSION:
            reference, tension = self._referencing, self._sensing.filter.value[:-1]
            self._estimator.start(
                reference.position, reference.quaternion, tension, reference.poses
            )
            self._guide.start(reference.position)
        elif state is State.SAFE_STOP:
            self.sequence.plan_stop(self._guide.plan_stop())

    def _change_loop(self, loop: TensionLoop) -> None:
        if loop is not self._loop:
            loop.take_over(self._loop)
            self._loop = loop

    def _estimate(self, image: ProcessImage) -> Estimate:
        sensing, sequence, tracker = self._sensing, self.sequence, image.tracker
        descent = self._descent
        if sequence.descending and self._loop is not descent.loop:
            self._estimator.loosen()
            self._isolation.descend()
            descent.begin(sensing.tension)
            self._change_loop(descent.loop)
        lengths = self._referencing.lengths(sensing.angle, sensing.tension, self._skipped)
        faults = sequence.faults
        believed = sensing.usable & ~faults.failed if faults.count else sensing.usable
        self._pulling = descent.pulling(sensing.tension, faults)
        estimator, elastic = self._estimator, self._referencing.elastic
        for _ in range(min(self._skipped, _MOST_SKIPPED) if self._skipped else 0):
            estimator.step(lengths, self._pulling, elastic, self._nobody)
        estimate = estimator.advance(lengths, self._pulling, elastic, believed)
        if sequence.descending:
            slack = sequence.sound & ~descent.taut
            self._isolation.reeled(self._kinematics.lengths, lengths, slack)
            self._isolation.lengths(estimator.strays, estimator.believed)
        self.accepted = bool(tracker["fresh"]) and estimator.track(
            tracker["position"], tracker["quaternion"], float(tracker["delay"])
        )
        return estimate

    def _regulate(self, estimate: Estimate) -> None:
        """Law, cap, limiter, wrench, distribution."""
        sensing, sequence, envelope = self._sensing, self.sequence, self._envelope
        bearing = sensing.usable if sequence.state in _BEARING else self._nobody
        contact = sensing.contact
        envelope(
            sensing.filtered,
            contact,
            estimate.position,
            estimate.velocity,
            bearing,
        )
        desired = self._guide(sequence.state, sequence.stop_time, envelope.progress)
        motion = Motion(
            *desired,
            estimate.position,
            estimate.quaternion,
            estimate.velocity,
            estimate.angular_velocity,
            estimate.external[:3],
            contact,
            self._allocation.shortfall,
            self._referencing.wound,
            sensing.winding,
            self._guide.push,
            *self._guide.attitude,
        )
        self._law = float(self._controller.stiffness(motion))
        cap = min(envelope.cap, sequence.stiffness_cap)
        stiffness = self._limiter(self._law, cap, motion.error, motion.error_rate, motion.external)
        allocation = self._allocation
        # Into an array of ours: another shape is an error, another type of number is converted.
        allocation.wrench[:] = (
            self._controller.descent(motion)
            if sequence.descending
            else self._controller.wrench(motion, stiffness)
        )
        sequence.height = estimate.position.item(2) - self._resting
        sequence.load = max(norm(motion.external) - motion.contact, 0.0)
        across, along, _ = motion.external.tolist()
        sequence.aside = max(math.hypot(across, along) - motion.contact, 0.0)
        if sequence.descending:
            allocation.wrench[:3] -= self._descent.balanced(
                self._kinematics.matrix, motion.external, sequence.faults, sequence.height
            )
            allocation.descend(self._descent, self._pulling, sequence.carrying, sequence.faults)
            sequence.missed = self._descent.distribution.deficit
            allocation.deliver(sensing.tension)
        else:
            allocation.distribute(
                motion, stiffness, sequence.levels, sequence.carrying, sensing.tension
            )
            active = sequence.state is _ACTIVE
            self._controller.applied(allocation.reference, sequence.elapsed if active else -1.0)

    def _drive(self, estimate: Estimate, usable: Mask) -> Array:
        """Torques (n,) for the references, zero but for drums that are ``usable`` (n,). Damped
        against the drum rates that follow the platform, or those desired."""
        _, velocity, acceleration = self._guide.desired
        sensing, loop, reference = self._sensing, self._loop, self._allocation.reference
        felt, descending = sensing.tension, self.sequence.descending
        if descending:
            felt = self._descent.felt(reference, felt, self.sequence.faults.failed)
        self._finite = loop.follow(
            self._kinematics.matrix,
            self._allocation.wrench,
            (estimate.velocity, estimate.angular_velocity),
            (velocity, acceleration, self._guide.attitude[1], self._guide.turning[2]),
            reference,
            sensing.tension,
            felt,
            sensing.rate,
            usable,
            self._kinematics.lengths,
            self._drum_motion,
            follows=self._controller.follows_platform and not descending,
        )
        return loop.torque
