"""The tick. `ControlCycle.step` is a pure function of its own state and its arguments:

    sensors, filters, estimator, stiffness law, envelope, distribution, tension loop

No clock, no input or output, no randomness, nothing that grows. What an operator says and what the
buses report come in as arguments, and the state machine is part of it, so that recorded inputs
reproduce every output bit for bit.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from config.schema.bus import Tracker
from config.schema.control import Control
from config.schema.robot import CABLES, Robot
from config.schema.scenario import Reference
from drivers.process_image import ProcessImage
from runtime.controllers import CONTROLLERS, Motion
from runtime.controllers.base import norm, share
from runtime.distribution import TensionDistribution, opposition
from runtime.envelope import Envelope
from runtime.estimator import Estimate, PoseEstimator
from runtime.guide import Guide
from runtime.kinematics import Kinematics
from runtime.passivity import Limiter
from runtime.referencing import Referencing
from runtime.sensing import Sensing
from runtime.sequence import Sequence
from runtime.signals import CycleRecord, Solver
from runtime.states import Operator, State
from runtime.stiffness import LawTerms
from runtime.tension import TensionLoop

Array = NDArray[np.float64]
_NOBODY = np.zeros(CABLES, dtype=bool)


@njit(cache=True)
def _bounds(
    before: Array,
    present: NDArray[np.bool_],
    levels: tuple[float, float, float, float],
    contraction: float,
    agonism: Array,
    low: Array,
    high: Array,
    centre: Array,
) -> None:
    """Bounds and centre of each tension: the configured ones, no further from the last reference
    than ``reach``, and zero where a cable is lost. ``levels``: low, high, centre, reach; the centre
    rises by the share ``contraction``, of antagonists more and of agonists less, since the wrench
    tightens these anyway.
    """
    lowest, highest, middle, reach = levels
    for i in range(before.shape[0]):
        low[i] = high[i] = centre[i] = 0.0
        if present[i]:
            low[i] = min(max(before[i] - reach, lowest), highest)
            high[i] = max(min(before[i] + reach, highest), lowest)
            wanted = middle * (1.0 + contraction * (1.0 - agonism[i]))
            centre[i] = min(max(wanted, lowest), highest)


class ControlCycle:
    """Everything the robot does in a millisecond."""

    def __init__(
        self, robot: Robot, control: Control, tracker: Tracker, reference: Reference
    ) -> None:
        period = control.rates.period
        self._robot, self._control, self._period = robot, control, period
        self.record = CycleRecord()
        self._kinematics = Kinematics(robot.geometry)
        self._sensing = Sensing(robot, control)
        self._envelope = Envelope(
            control.envelope, control.tension, control.stiffness, robot, period
        )
        self._referencing = Referencing(robot, control.sequence, Kinematics(robot.geometry))
        self.sequence = Sequence(control, self._sensing, self._referencing, self._envelope)
        self._guide = Guide(robot, control.sequence, control.envelope, reference, period)
        self._estimator = PoseEstimator(robot, control.estimator, tracker, self._kinematics, period)
        self._controller = CONTROLLERS[control.controller](robot, control)
        ratio = self._controller.damping_ratio
        self._limiter = Limiter(control.stiffness, control.passivity, robot, ratio, period)
        self._distribution = TensionDistribution(control.distribution, robot.geometry.moment_length)
        self._loop = self._usual_loop = TensionLoop(robot, control.tension_loop, period)
        self._active_loop = self._usual_loop
        if self._controller.tension_loop != control.tension_loop:
            self._active_loop = TensionLoop(robot, self._controller.tension_loop, period)
        self._reference = np.zeros(CABLES)
        self._centre = np.zeros(CABLES)
        self._agonism, self._gradient = np.zeros(CABLES), np.zeros(CABLES)
        self._desired_drums = (np.zeros(CABLES), np.zeros(CABLES))
        self._low, self._high = np.zeros(CABLES), np.zeros(CABLES)
        self._wrench = np.zeros(6)
        self._shortfall = np.zeros(3)
        self._law = 0.0
        self._contraction = 0.0
        """share by which all tensions are raised, on its way to what the stiffness asks for"""
        activation = control.distribution.co_contraction_hz
        self._activate = 1.0 if activation is None else share(activation, period)
        self._accepted = False
        self._finite = True

    def step(self, image: ProcessImage, tick: int, operator: Operator) -> CycleRecord:
        """One tick: reads ``image.axes``, ``image.cells`` and ``image.tracker``, writes
        ``image.commands`` and the record."""
        sensing, sequence = self._sensing, self.sequence
        sensing.step(image, tick)
        if sequence.step(image, tick, operator, finite=self._finite):
            self._enter(sequence.state)
        image.commands["command"] = sequence.axis_command
        estimate = None
        if sequence.regulating:
            estimate = self._estimate(image)
            self._regulate(estimate)
            rate = self._drum_rate(estimate)
            self._desired_drums = self._drums_of(*self._guide.desired[1:])
            if not (self._controller.follows_platform or sequence.descending):
                rate = self._desired_drums[0]
            self._finite = bool(np.isfinite(self._wrench).all() and np.isfinite(rate).all())
        elif sequence.straightening >= 0.0:
            self._reference[:] = sequence.straightening * self._control.tension.referencing
            rate = np.zeros(CABLES)
        else:
            self._reference[:] = 0.0
            rate = None
        if rate is None:
            image.commands["torque"] = 0.0
        else:
            image.commands["torque"] = self._loop(
                self._reference,
                sensing.tension,
                rate,
                sensing.rate,
                sensing.usable & sequence.carrying,
                self._kinematics.lengths,
                self._desired_drums if sequence.regulating else None,
            )
        self._write_inputs(image, tick, operator)
        self._write_results(image, estimate)
        return self.record

    def _enter(self, state: State) -> None:
        self._finite = True
        loop = self._active_loop if state is State.ACTIVE else self._usual_loop
        if loop is not self._loop:
            loop.take_over(self._loop)
            self._loop = loop
        if state is State.REFERENCING:
            self._loop.reset()
            self._limiter.reset()
            self._controller.reset()
            self._contraction = 0.0
        elif state is State.PRETENSION:
            reference, tension = self._referencing, self._sensing.filter.value[:CABLES]
            self._estimator.start(
                reference.position, reference.quaternion, tension, reference.poses
            )
            self._guide.start(reference.position)
        elif state is State.SAFE_STOP:
            self.sequence.plan_stop(self._guide.plan_stop())

    def _estimate(self, image: ProcessImage) -> Estimate:
        sensing, tracker = self._sensing, image.tracker
        lengths = self._referencing.lengths(sensing.angle, sensing.tension)
        estimate = self._estimator.step(lengths, sensing.tension, sensing.usable)
        self._accepted = bool(tracker["fresh"]) and self._estimator.track(
            tracker["position"], tracker["quaternion"], float(tracker["delay"])
        )
        return estimate

    def _regulate(self, estimate: Estimate) -> None:
        """Law, cap, limiter, wrench, distribution."""
        sensing, sequence, envelope = self._sensing, self.sequence, self._envelope
        bearing = sensing.usable if sequence.state in (State.HOLD, State.ACTIVE) else _NOBODY
        envelope(
            sensing.filter.value[:CABLES],
            sensing.contact,
            estimate.position,
            estimate.velocity,
            bearing,
        )
        desired = self._guide(sequence.state, sequence.stop_time, envelope.progress)
        radius = self._robot.drum.radius
        motion = Motion(
            *desired,
            estimate.position,
            estimate.quaternion,
            estimate.velocity,
            estimate.angular_velocity,
            estimate.external[:3],
            sensing.contact,
            self._shortfall,
            self._referencing.unstretched - radius * sensing.angle,
            radius * sensing.rate,
            self._guide.push,
        )
        self._law = self._controller.stiffness(motion)
        cap = min(envelope.cap, sequence.stiffness_cap)
        stiffness = self._limiter(self._law, cap, motion.error, motion.error_rate, motion.external)
        descending = sequence.descending
        self._wrench = (
            self._controller.descent(motion)
            if descending
            else self._controller.wrench(motion, stiffness)
        )
        sequence.load = max(norm(motion.external) - motion.contact, 0.0)
        self._distribute(motion, stiffness)

    def _distribute(self, motion: Motion, stiffness: float) -> None:
        """Co-contraction follows the stiffness; a cable that cannot be trusted carries nothing."""
        levels, present = self.sequence.levels, self.sequence.carrying
        level = levels.level * self._controller.tone
        settings, base = self._control.distribution, self._control.stiffness.base
        matrix = self._kinematics.matrix
        contraction = settings.co_contraction * (stiffness / base - 1.0)
        self._contraction += self._activate * (contraction - self._contraction)
        opposition(
            matrix,
            self._kinematics.lengths,
            self._wrench[:3],
            settings.least_force,
            self._agonism,
            self._gradient,
        )
        _bounds(
            self._reference,
            present,
            (levels.low, levels.high, level, settings.tension_rate * self._period),
            self._contraction,
            self._agonism,
            self._low,
            self._high,
            self._centre,
        )
        wanted = self._controller.tensions(motion, stiffness, self._centre)
        if wanted is not None and not self.sequence.descending:
            self._centre[:] = wanted * present
            self._wrench = matrix @ self._centre
        self._reference = self._distribution(
            matrix * present, self._wrench, self._centre, self._low, self._high, self._gradient
        )
        self._shortfall = self._wrench[:3] - matrix[:3] @ self._reference

    def _drum_rate(self, estimate: Estimate) -> Array:
        """Drum rates (8,) that follow the platform at constant tension (eq. 1)."""
        twist = np.concatenate([estimate.velocity, estimate.angular_velocity])
        stretch = 1.0 + self._sensing.tension / self._robot.cable.axial_stiffness
        rate = (self._kinematics.matrix.T @ twist) / (self._robot.drum.radius * stretch)
        return np.asarray(rate)

    def _drums_of(self, velocity: Array, acceleration: Array) -> tuple[Array, Array]:
        """Rates and accelerations (8,) of the drums on the desired motion, level."""
        pull = self._kinematics.matrix[:3].T / self._robot.drum.radius
        return pull @ velocity, pull @ acceleration

    def _write_inputs(self, image: ProcessImage, tick: int, operator: Operator) -> None:
        record, sensing, sequence = self.record, self._sensing, self.sequence
        record.timing.tick[...] = tick
        state = record.state
        state.elapsed[...] = sequence.elapsed
        state.scenario_time[...] = self._guide.time
        state.inputs[...] = image.checksum(tick * len(Operator) + operator)
        state.fault[...] = sequence.fault
        state.fault_where[...] = sequence.where
        state.state[...] = sequence.state
        state.operator[...] = operator
        drives, axes = record.drives, image.axes
        drives.angle[:] = axes["angle"]
        drives.torque[:] = axes["torque"]
        drives.rate[:] = sensing.rate
        drives.age[:] = axes["age"]
        drives.statusword[:] = axes["statusword"]
        drives.error_code[:] = axes["error_code"]
        drives.state[:] = axes["state"]
        cells = record.force_cells
        cells.raw[:] = image.cells["force"]
        cells.tare[:] = sensing.tare
        cells.filtered[:] = sensing.filter.value
        cells.age[:] = image.cells["age"]
        cells.status[:] = image.cells["status"]
        tracker, seen = record.tracker, image.tracker
        tracker.position[:] = seen["position"]
        tracker.quaternion[:] = seen["quaternion"]
        tracker.delay[...] = seen["delay"]
        tracker.sequence[...] = seen["sequence"]
        tracker.fresh[...] = seen["fresh"]

    def _write_results(self, image: ProcessImage, estimate: Estimate | None) -> None:
        record, sensing = self.record, self._sensing
        record.drives.torque_command[:] = image.commands["torque"]
        record.drives.command[:] = image.commands["command"]
        tension = record.tension
        tension.reference[:] = self._reference
        tension.measured[:] = sensing.tension
        tension.integral[:] = self._loop.integral
        if estimate is None:
            tension.solver[...] = Solver.NONE
            return
        distribution = self._distribution
        tension.solver[...] = distribution.solver
        tension.iterations[...] = distribution.iterations
        tension.co_contraction[:] = self._centre
        tension.agonism[:] = self._agonism
        pose, estimator, tracker = record.pose, self._estimator, record.tracker
        tracker.accepted[...] = self._accepted
        tracker.disagreement[...] = estimator.disagreement.distance
        tracker.refused[...] = estimator.disagreement.poses
        tracker.learnt[...] = estimator.disagreement.learnt
        pose.position[:] = estimate.position
        pose.quaternion[:] = estimate.quaternion
        pose.velocity[:] = estimate.velocity
        pose.angular_velocity[:] = estimate.angular_velocity
        position, velocity, acceleration = self._guide.desired
        pose.desired_position[:] = position
        pose.desired_velocity[:] = velocity
        pose.desired_acceleration[:] = acceleration
        pose.cable_position[:] = estimator.cable_position
        pose.bias[:] = estimator.bias
        pose.residual[...] = estimator.residual
        pose.length_offset[:] = estimator.offsets
        pose.compliance[...] = estimator.compliance
        pose.sigma[...] = estimator.sigma
        pose.inconsistency[...] = estimator.inconsistency
        pose.condition[...] = estimator.condition
        pose.consistency[...] = estimator.consistency
        self._write_law(record.stiffness, self._controller.terms)
        self._write_energy(record.energy)
        wrench = record.wrench
        wrench.commanded[:] = self._wrench
        wrench.delivered[:] = self._kinematics.matrix @ self._reference
        wrench.external[:] = estimate.external
        wrench.deficit[...] = distribution.deficit
        wrench.contact[...] = sensing.contact
        margins, envelope = record.envelope, self._envelope
        margins.tension_high[...] = envelope.tension_high
        margins.tension_low[...] = envelope.tension_low
        margins.contact[...] = envelope.contact
        margins.speed[...] = envelope.speed
        margins.workspace[...] = envelope.workspace
        margins.progress[...] = envelope.progress
        margins.grade[...] = envelope.grade
        margins.bound[...] = envelope.bound

    def _write_law(self, stiffness: SimpleNamespace, terms: LawTerms) -> None:
        stiffness.law[...] = self._law
        stiffness.velocity_term[...] = terms.velocity
        stiffness.force_term[...] = terms.force
        stiffness.deviation_term[...] = terms.deviation
        stiffness.cap[...] = self._envelope.cap
        stiffness.k_eq[...] = self._limiter.value
        geometric = float(self._gradient @ self._sensing.tension)
        stiffness.measured[...] = self._limiter.value + geometric

    def _write_energy(self, energy: SimpleNamespace) -> None:
        limiter, account = self._limiter, self._limiter.account
        energy.storage[...] = account.storage
        energy.storage_rate[...] = account.storage_rate
        energy.stiffening[...] = account.stiffening
        energy.dissipated[...] = account.dissipated
        energy.external[...] = account.external
        energy.tank[...] = limiter.tank.level
        energy.k_rate[...] = account.stiffness_rate
        energy.rise_bound[...] = limiter.rise_bound(limiter.value)
