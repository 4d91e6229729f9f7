"""Carries one trial out in virtual time, from OFF, without a log: its records stay in memory."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.root import Config
from tonus.drivers.devices.tracker import TrackerInput
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.daemon import Daemon, Outcome
from tonus.runtime.operation.operator import Script
from tonus.runtime.recording.taps import Level
from tonus.runtime.safety.sequence import Sequence
from tonus.runtime.signals import cycle_dtype
from tonus.runtime.states import Fault, Operator, State
from tonus.runtime.timing import clock
from tonus.runtime.timing.scheduler import VirtualPacing
from tonus.sim.lab.engine import Lab
from tonus.sim.lab.truth import truth_dtype
from tonus.tools.log.log import Event
from tonus.tools.paper.case import Kind, Run
from tonus.tools.paper.trial import Trial
from tonus.tools.run import fieldbuses
from tonus.tools.run.supervision import without_relay

SLOW_TICKS = 10
"""A trial of stage 1 moves at 1 mm/s for minutes: one tick in so many is kept."""


class _UntilDone(Script):
    """As a script, but the run ends where its ACTIVE does: nothing is judged on the way down. A run
    that a fault stops goes on to its end."""

    def next(self, sequence: Sequence) -> Operator:
        if sequence.state is State.ACTIVE and sequence.elapsed >= self._duration:
            self._over = True
            return Operator.NONE
        return super().next(sequence)


class _Rows:
    """Records of one type by their time, in an array that grows; every ``stride`` ns is kept."""

    def __init__(self, dtype: np.dtype[Any], stride_ns: int) -> None:
        self._rows = np.zeros(1024, dtype)
        self._stamps = np.zeros(1024, np.int64)
        self._stride_ns = stride_ns
        self._count = 0

    def publish(self, record: NDArray[Any], stamp_ns: int) -> None:
        if stamp_ns % self._stride_ns:
            return
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
            self._stamps = np.concatenate([self._stamps, np.zeros_like(self._stamps)])
        self._rows[self._count] = record[0]
        self._stamps[self._count] = stamp_ns
        self._count += 1

    @property
    def stamps(self) -> NDArray[np.int64]:
        return self._stamps[: self._count]

    @property
    def rows(self) -> NDArray[Any]:
        return self._rows[: self._count]


class _Cycles(_Rows):
    """The records of ACTIVE."""

    def publish(self, payload: NDArray[Any], stamp_ns: int) -> None:
        if payload["state"]["state"][0] == State.ACTIVE:
            super().publish(payload, stamp_ns)


class _Conduct:
    """One run: everything on one virtual loop."""

    def __init__(self, run: Run, config: Config) -> None:
        self._run, self._config = run, without_relay(config)
        stride = SLOW_TICKS if run.case.kind is Kind.SLOPE else 1
        stride_ns = stride * config.control.rates.period_ns
        cables = config.robot.cables
        self.cycles = _Cycles(cycle_dtype(cables), stride_ns)
        self.truths = _Rows(truth_dtype(cables), stride_ns)
        self.events: list[Event] = []
        self.contact_peak = 0.0

    async def play(self) -> Outcome:
        run, config = self._run, self._config
        image = ProcessImage(config.robot.cables)
        lab = Lab(
            config, run.case.scenario.lab, seed=run.seed, clock=clock.loop_clock(), truth=self._true
        )
        lab.open()
        fieldbus = fieldbuses.build(config, image, lab)
        daemon = Daemon(
            config,
            run.case.scenario,
            fieldbus,
            TrackerInput(image, lab.tracker),
            _UntilDone(run.case.scenario.duration),
            ring=self.cycles,
            events=self._event,
            stopwatch=clock.Stopwatch(running=False),
        )
        try:
            return await daemon.run(VirtualPacing, lambda _: None, lambda: None)
        finally:
            lab.close()

    def _true(self, record: NDArray[Any], stamp_ns: int) -> None:
        self.contact_peak = max(self.contact_peak, float(record["contact_force"][0]))
        self.truths.publish(record, stamp_ns)

    def _event(
        self, stamp_ns: int, tick: int, level: Level, name: str, where: str, text: str
    ) -> None:
        self.events.append(Event(stamp_ns, tick, int(level), name, where, text))


def conduct(
    run: Run,
    config: Config,
    *,
    cycle: Collection[str] | None = None,
    truth: Collection[str] | None = None,
) -> Trial:
    """Carry a trial out. ``config`` is its own, `plants.settle`. ``cycle`` ("pose.position") and
    ``truth`` ("position") name the fields that are wanted, None: all.

    Raises a `DriverError` when the bus cannot be brought up.
    """
    at_work = _Conduct(run, config)
    outcome = clock.run(at_work.play(), virtual=True)
    stamps, here, there = np.intersect1d(
        at_work.cycles.stamps, at_work.truths.stamps, assume_unique=True, return_indices=True
    )
    cycles, truths = at_work.cycles.rows[here], at_work.truths.rows[there]
    seconds = (stamps - stamps[0]) * 1e-9 if len(stamps) else np.zeros(0)
    return Trial(
        run=run,
        config=config,
        time=seconds,
        cycle={
            f"{topic}.{field}": np.ascontiguousarray(cycles[topic][field])
            for topic in cycles.dtype.names or ()
            for field in cycles.dtype[topic].names or ()
            if cycle is None or f"{topic}.{field}" in cycle
        },
        truth={
            name: np.ascontiguousarray(truths[name])
            for name in truths.dtype.names or ()
            if truth is None or name in truth
        },
        state=outcome.state.name,
        reason=outcome.reason,
        fault="" if outcome.fault is Fault.NONE else outcome.fault.name.lower(),
        events=at_work.events,
        contact_peak=at_work.contact_peak,
        ticks=outcome.ticks,
    )
