"""Carries trials out in virtual time, from OFF, without a log: their records stay in memory.

Trials that differ only in what begins with ACTIVE have one bring-up: each goes on from there in a
fork of the process, and is bit for bit what it would have been from OFF.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.lab import LabScript
from tonus.config.schema.root import Config
from tonus.drivers.devices.tracker import TrackerInput
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.daemon import Daemon, Outcome
from tonus.runtime.ports import LEFT_OUT, Recorded
from tonus.runtime.recording.taps import Level
from tonus.runtime.safety.sequence import Sequence as ControlSequence
from tonus.runtime.signals import cycle_dtype
from tonus.runtime.states import Fault, Operator, State
from tonus.runtime.timing import clock
from tonus.sim.lab.engine import Lab
from tonus.sim.lab.truth import truth_dtype
from tonus.tools.log.log import Event
from tonus.tools.paper.case import Kind, Run
from tonus.tools.paper.trial import Trial
from tonus.tools.run import fieldbuses
from tonus.tools.run.kept import Kept
from tonus.tools.run.parting import Parting, Selecting
from tonus.tools.run.supervision import without_relay
from tonus.tools.run.turning import TurningPacing

SLOW_TICKS = 10
"""A trial of stage 1 moves at 1 mm/s for minutes: one tick in so many is kept."""
_ACTIVE = State.ACTIVE


class _UntilDone(Selecting):
    """As a script, but the run ends where its ACTIVE does: nothing is judged on the way down. A run
    that a fault stops goes on to its end."""

    def next(self, sequence: ControlSequence) -> Operator:
        if sequence.state is _ACTIVE and sequence.elapsed >= self._duration:
            self._over = True
            return Operator.NONE
        return super().next(sequence)


class Together:
    """Trials of one configuration and one seed whose scenarios differ in the reference, the load,
    the phantom and the duration alone. After `play` each process that returns has played those in
    `left`."""

    def __init__(
        self,
        runs: Sequence[Run],
        config: Config,
        script: LabScript,
        lost: Callable[[Run, int], None],
    ) -> None:
        """``config``: that of all, `plants.settle`. ``script``: what is there before ACTIVE.
        ``lost`` is called with a trial whose process died, and its exit code."""
        self._runs, self._config = runs, config
        self._shared = script if len(runs) > 1 else runs[0].case.scenario.lab
        self._stride = SLOW_TICKS if runs[0].case.kind is Kind.SLOPE else 1
        stride_ns = self._stride * config.control.rates.period_ns
        cables = config.robot.cables
        self._cycles = Kept(cycle_dtype(cables))
        self._truths = Kept(truth_dtype(cables), stride_ns)
        self._events: list[Event] = []
        self._contact_peak = 0.0
        self._scenarios = [run.case.scenario for run in runs]
        self._script = _UntilDone(self._scenarios[0].duration)
        self._parting = Parting(
            self._scenarios,
            self._shared,
            self._script,
            lambda number, code: lost(runs[number], code),
        )
        self._lab: Lab | None = None

    @property
    def left(self) -> list[Run]:
        """Those that this process plays, or has played."""
        return [self._runs[number] for number in self._parting.left]

    def play(
        self, cycle: Collection[str] | None = None, truth: Collection[str] | None = None
    ) -> list[Trial]:
        """The trials of `left`: one, or all of them where the robot never came to ACTIVE. ``cycle``
        ("pose.position") and ``truth`` ("position") name the fields that are wanted, None: all.

        Raises a `DriverError` when the bus cannot be brought up.
        """
        lean = cycle is not None and LEFT_OUT.isdisjoint(cycle)
        recorded = Recorded(self._stride, frozenset({_ACTIVE}), lean)
        outcome = clock.run(self._main(recorded), virtual=True)
        first = self._trial(outcome, cycle, truth)
        return [replace(first, run=run) for run in self.left]

    async def _main(self, recorded: Recorded) -> Outcome:
        config, scenarios = without_relay(self._config), self._scenarios
        image = ProcessImage(config.robot.cables)
        lab = self._lab = Lab(
            config,
            self._shared,
            seed=self._runs[0].seed,
            clock=clock.loop_clock(),
            truth=self._true,
        )
        lab.open()
        fieldbus = fieldbuses.build(config, image, lab)
        daemon = Daemon(
            config,
            scenarios[0],
            fieldbus,
            TrackerInput(image, lab.tracker),
            self._script,
            ring=self._cycles,
            events=self._event,
            stopwatch=clock.Stopwatch(running=False),
            others=scenarios[1:],
            recorded=recorded,
        )
        parting = self._parting
        parting.of(daemon, lab, lambda: self._truths.rows["position"])
        try:
            return await daemon.run(
                lambda: TurningPacing(parting.before_tick), lambda _: None, lambda: None
            )
        finally:
            lab.close()

    def _true(self, record: NDArray[Any], stamp_ns: int) -> None:
        assert self._lab is not None
        self._contact_peak = max(self._contact_peak, self._lab.plant.contact_force.item())
        self._truths.publish(record, stamp_ns)

    def _event(
        self, stamp_ns: int, tick: int, level: Level, name: str, where: str, text: str
    ) -> None:
        self._events.append(Event(stamp_ns, tick, int(level), name, where, text))

    def _trial(
        self, outcome: Outcome, cycle: Collection[str] | None, truth: Collection[str] | None
    ) -> Trial:
        stamps, here, there = np.intersect1d(
            self._cycles.stamps, self._truths.stamps, assume_unique=True, return_indices=True
        )
        cycles, truths = self._cycles.rows, self._truths.rows
        seconds = (stamps - stamps[0]) * 1e-9 if len(stamps) else np.zeros(0)
        return Trial(
            run=self.left[0],
            config=self._config,
            time=seconds,
            cycle={
                f"{topic}.{field}": cycles[topic][field][here]
                for topic in cycles.dtype.names or ()
                for field in cycles.dtype[topic].names or ()
                if cycle is None or f"{topic}.{field}" in cycle
            },
            truth={
                name: truths[name][there]
                for name in truths.dtype.names or ()
                if truth is None or name in truth
            },
            state=outcome.state.name,
            reason=outcome.reason,
            fault="" if outcome.fault is Fault.NONE else outcome.fault.name.lower(),
            events=self._events,
            contact_peak=self._contact_peak,
            ticks=outcome.ticks,
        )


def conduct(run: Run, config: Config) -> Trial:
    """Carry one trial out in this process, with every field. ``config`` is its own,
    `plants.settle`.

    Raises a `DriverError` when the bus cannot be brought up.
    """
    (trial,) = Together([run], config, run.case.scenario.lab, lambda *_: None).play()
    return trial
