"""What a tick writes into its record: its inputs, what the drives are told, and what each stage
found."""

from __future__ import annotations

import struct
import zlib

from tonus.drivers.process_image import ProcessImage
from tonus.runtime.control.allocation import Allocation
from tonus.runtime.control.controllers import Controller
from tonus.runtime.control.estimator import PoseEstimator
from tonus.runtime.control.guide import Guide
from tonus.runtime.control.passivity import Limiter
from tonus.runtime.control.sensing import Sensing
from tonus.runtime.control.tension import TensionLoop
from tonus.runtime.control.tuning import GainChange, Tuning
from tonus.runtime.recording.record_writers import (
    write_found,
    write_law,
    write_margins,
    write_measured,
    write_motion,
)
from tonus.runtime.safety.envelope import Envelope
from tonus.runtime.safety.sequence import Sequence
from tonus.runtime.signals import CycleRecord, Solver
from tonus.runtime.states import Operator

_CHANGE = struct.Struct("<Bd")
_SELECT_BIT = 24
"""of the checksum's start, so that a tick without a choice has the checksum of its inputs alone"""


class CycleWriter:
    """Writes the record of a tick from the stages that it went through."""

    def __init__(
        self,
        record: CycleRecord,
        sensing: Sensing,
        sequence: Sequence,
        guide: Guide,
        estimator: PoseEstimator,
        controller: Controller,
        limiter: Limiter,
        envelope: Envelope,
        allocation: Allocation,
        tuning: Tuning,
    ) -> None:
        self._record, self._sensing, self._sequence = record, sensing, sequence
        self._guide, self._estimator, self._controller = guide, estimator, controller
        self._limiter, self._envelope, self._allocation = limiter, envelope, allocation
        self._tuning = tuning

    def inputs(
        self, image: ProcessImage, tick: int, operator: Operator, select: int, change: GainChange
    ) -> None:
        record, sensing, sequence = self._record, self._sensing, self._sequence
        record.timing.tick[...] = tick
        state = record.state
        state.elapsed[...] = sequence.elapsed
        state.scenario_time[...] = self._guide.time
        said = tick * len(Operator) + operator
        checksum = image.checksum(said ^ select << _SELECT_BIT)
        state.inputs[...] = (
            zlib.crc32(_CHANGE.pack(*change), checksum) if change.number else checksum
        )
        state.fault[...] = sequence.fault
        state.fault_where[...] = sequence.where
        state.stop_mode[...] = sequence.stop_mode
        state.failed[:] = sequence.faults.failed
        state.state[...] = sequence.state
        state.operator[...] = operator
        state.select[...] = select
        state.scenario[...] = self._guide.chosen
        tuning = record.tuning
        number, value = change
        tuning.parameter[...] = number
        tuning.value[...] = value
        tuning.gains[:] = self._tuning.gains
        write_measured(
            record.data,
            image.axes,
            image.cells,
            image.tracker,
            sensing.rate,
            sensing.tare,
            sensing.filter.value,
        )

    def torques(self, image: ProcessImage, loop: TensionLoop) -> None:
        """What the drives are told, and the ``loop`` that it comes from."""
        record = self._record
        record.drives.torque_command[:] = image.commands["torque"]
        record.drives.command[:] = image.commands["command"]
        tension = record.tension
        tension.reference[:] = self._allocation.reference
        tension.measured[:] = self._sensing.tension
        tension.integral[:] = loop.integral

    def results(self, law: float, *, accepted: bool) -> None:
        """What is there only while the platform is regulated: ``law`` (N/m), the stiffness law's
        value, and whether a tracker pose was accepted."""
        record, tension, estimate = self._record, self._record.tension, self._estimator.estimate
        allocation = self._allocation
        if not self._sequence.regulating:
            tension.solver[...] = Solver.NONE
            record.tracker.accepted[...] = False
            return
        distribution, estimator = allocation.distribution, self._estimator
        disagreement = estimator.disagreement
        tension.solver[...] = distribution.solver
        record.tracker.accepted[...] = accepted
        write_found(
            record.data,
            distribution.iterations,
            disagreement.distance,
            disagreement.poses,
            disagreement.learnt,
            estimator.residual,
            estimator.sigma,
            estimator.inconsistency,
            estimator.condition,
            int(estimator.consistency),
        )
        tension.co_contraction[:] = allocation.centre
        tension.agonism[:] = allocation.agonism
        write_motion(
            record.data,
            (
                estimate.position,
                estimate.quaternion,
                estimate.velocity,
                estimate.angular_velocity,
                estimate.external,
            ),
            self._guide.desired,
            self._guide.attitude[0],
            estimator.cable_position,
            estimator.bias,
            estimator.offsets,
            estimator.compliances,
        )
        limiter, envelope = self._limiter, self._envelope
        account, terms = limiter.account, self._controller.terms
        write_law(
            record.data,
            law,
            float(terms.velocity),
            float(terms.force),
            float(terms.deviation),
            envelope.cap,
            limiter.value,
            allocation.geometric,
            account.storage,
            account.stiffening,
            account.dissipated,
            account.external,
            limiter.tank.level,
            account.stiffness_rate,
            limiter.rise_bound(limiter.value),
        )
        write_margins(
            record.data,
            envelope.tension_high,
            envelope.tension_low,
            envelope.contact,
            envelope.speed,
            envelope.workspace,
            envelope.progress,
            int(envelope.grade),
            int(envelope.bound),
        )
        wrench = record.wrench
        wrench.commanded[:] = allocation.wrench
        wrench.delivered[:] = allocation.delivered
        wrench.deficit[...] = distribution.deficit
        wrench.contact[...] = self._sensing.contact
