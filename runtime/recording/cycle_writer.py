"""What a tick writes into its record: its inputs, what the drives are told, and what each stage
found."""

from __future__ import annotations

import struct
import zlib
from typing import Any

from tonus.drivers.process_image import ProcessImage
from tonus.runtime.control.allocation import Allocation
from tonus.runtime.control.controllers import Controller
from tonus.runtime.control.estimator import PoseEstimator
from tonus.runtime.control.guide import Guide
from tonus.runtime.control.passivity import Limiter
from tonus.runtime.control.sensing import Sensing
from tonus.runtime.control.tension import TensionLoop
from tonus.runtime.control.tuning import GainChange, Tuning
from tonus.runtime.recording.record_writers import write_results, write_tick
from tonus.runtime.safety.envelope import Envelope
from tonus.runtime.safety.sequence import Sequence
from tonus.runtime.signals import CycleRecord, Solver
from tonus.runtime.states import Operator

_CHANGE = struct.Struct("<Bd")
_UNGUARDED = (b"", b"unguarded", b"ignored", b"unguarded ignored")
_NO_SOLVER = int(Solver.NONE)
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
        self._measured: tuple[Any, ...] = (sensing.rate, sensing.tare, sensing.filter.value)
        self._found: tuple[Any, ...] = (
            *estimator.found,
            allocation.centre,
            allocation.agonism,
            allocation.wrench,
            allocation.delivered,
        )

    def tick(
        self,
        image: ProcessImage,
        tick: int,
        operator: Operator,
        select: int,
        change: GainChange,
        loop: TensionLoop,
        *,
        accepted: bool,
        lean: bool,
    ) -> None:
        """What every tick has; ``loop``: where its torques come from; ``accepted``: whether a
        tracker pose was; ``lean``: without the checksum of its inputs."""
        sensing, sequence, guide = self._sensing, self._sequence, self._guide
        allocation = self._allocation
        number, value = change
        unguarded = image.unguarded | image.supervisor_ignored << 1
        checksum = 0 if lean else _checksum(image, tick, operator, select, change, unguarded)
        regulating = sequence.regulating
        faults, gains = sequence.faults, self._tuning.gains
        write_tick(
            self._record.data,
            image.axes,
            image.cells,
            image.tracker,
            image.commands,
            faults.failed,
            allocation.reference,
            sensing.tension,
            loop.integral,
            tick,
            sequence.elapsed,
            guide.time,
            checksum,
            int(faults.first),
            faults.where,
            int(sequence.stop_mode),
            int(sequence.state),
            int(operator),
            select,
            guide.chosen,
            unguarded,
            number,
            float(value),
            gains[0],
            gains[1],
            gains[2],
            int(allocation.distribution.solver) if regulating else _NO_SOLVER,
            accepted and regulating,
            *self._measured,
        )

    def results(self, law: float) -> None:
        """What is there only while the platform is regulated; ``law``: N/m, the stiffness law's
        value."""
        allocation, estimator, limiter = self._allocation, self._estimator, self._limiter
        envelope, guide = self._envelope, self._guide
        distribution, disagreement = allocation.distribution, estimator.disagreement
        account, terms = limiter.account, self._controller.terms
        write_results(
            self._record.data,
            *guide.desired,
            guide.attitude[0],
            distribution.iterations,
            disagreement.distance,
            disagreement.poses,
            disagreement.learnt,
            estimator.residual,
            estimator.sigma,
            estimator.inconsistency,
            estimator.condition,
            int(estimator.consistency),
            distribution.deficit,
            self._sensing.contact,
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
            account.stiffness_rate,
            limiter.tank.level,
            limiter.rise_bound(limiter.value),
            envelope.tension_high,
            envelope.tension_low,
            envelope.contact,
            envelope.speed,
            envelope.workspace,
            envelope.progress,
            int(envelope.grade),
            int(envelope.bound),
            *self._found,
        )


def _checksum(
    image: ProcessImage,
    tick: int,
    operator: Operator,
    select: int,
    change: GainChange,
    unguarded: int,
) -> int:
    """Of all that the tick was given."""
    said = tick * len(Operator) + operator
    checksum = image.checksum(said ^ select << _SELECT_BIT)
    if change.number:
        checksum = zlib.crc32(_CHANGE.pack(*change), checksum)
    if unguarded:
        checksum = zlib.crc32(_UNGUARDED[unguarded], checksum)
    return checksum
