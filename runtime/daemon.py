"""The daemon: one bus, one tick, one record, until the commander is done.

    collect → act → publish → write → record

All that is slow (bring-up, files, people) lies before, after or outside the ticks.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from config.schema.root import Config
from config.schema.scenario import Scenario
from drivers.fieldbus import BusEvent, Fieldbus, Progress
from runtime.clock import Stopwatch, now_ns
from runtime.cycle import ControlCycle
from runtime.histogram import Histogram
from runtime.keyframe import Keyframe
from runtime.operator import Commander
from runtime.overruns import Overruns
from runtime.reporter import EventSink, Reporter
from runtime.scheduler import Misses, Pacing, Scheduler
from runtime.self_test import SelfTest
from runtime.states import Fault, Operator, State
from runtime.taps import Level

_NOTICEABLE_S = 0.5
"""Slowing at the start and at the end takes a tenth of a second; more was the envelope."""
_SERVICE_PERIOD_S = 0.02
"""between two looks at the control socket while the bus is brought up"""


def _nobody(due_ns: int) -> None:
    """Nobody is to be served."""


class TrackerDoor(Protocol):
    """Brings the tracker's poses into the image."""

    def collect(self, now_ns: int) -> None: ...

    def take_events(self) -> list[BusEvent]: ...


class Ring(Protocol):
    """Where the cycle record goes."""

    def publish(self, payload: NDArray[np.void], stamp_ns: int) -> None: ...


class KeyframeSink(Protocol):
    """Where the cycle's state goes now and then."""

    def __call__(self, stamp_ns: int, tick: int, state: bytes) -> None: ...


@dataclass
class Outcome:
    """How a run ended."""

    state: State
    fault: Fault
    reason: str
    ticks: int
    misses: Misses
    overrun: bool = False
    """it was stopped because ticks were missed"""
    obstacle: str = ""
    """why the robot was never armed; empty if it was, or nobody asked"""


class Latencies:
    """Histograms of a run so far; empty in virtual time, where the host is not to be seen."""

    def __init__(self) -> None:
        self.wakeup, self.compute, self.cycle, self.slack = (Histogram() for _ in range(4))


class Daemon:
    """Owns the cycle and drives it; everything it talks to is handed in."""

    def __init__(
        self,
        config: Config,
        scenario: Scenario,
        fieldbus: Fieldbus,
        tracker: TrackerDoor,
        commander: Commander,
        *,
        ring: Ring,
        events: EventSink,
        stopwatch: Stopwatch,
        keyframes: KeyframeSink | None = None,
        others: Sequence[Scenario] = (),
    ) -> None:
        """``others``: scenarios that may be chosen instead, by their numbers from 1 on."""
        self._config = config
        self._fieldbus, self._tracker, self._commander = fieldbus, tracker, commander
        self._ring, self._events, self._stopwatch = ring, events, stopwatch
        references = [other.reference for other in others]
        self.cycle = ControlCycle(
            config.robot, config.control, config.tracker, scenario.reference, references
        )
        self._reporter = Reporter(config, self.cycle, events)
        self.self_test = SelfTest(config)
        self.scheduler: Scheduler | None = None
        """there is one once the bus is up"""
        self.service: Callable[[int], None] = _nobody
        """called with the due time (ns) after each tick, and now and then before the first: people
        are served then, in bounded time"""
        self._duration = scenario.duration
        self._keyframes, self._keyframe = keyframes, Keyframe(self.cycle)
        self._keyframe_ticks = round(config.recording.keyframe_s / config.control.rates.period)
        self._keyframe_due = 0
        self._kept: tuple[int, int, Iterator[bytes]] | None = None
        self._due_ns = self._after_ns = 0
        self._overruns = Overruns(config.realtime)
        self.latencies = Latencies()
        self._recovery: asyncio.Task[None] | None = None
        self._refused = ""
        self._who = self._resetting_for = ""

    async def run(
        self,
        pacing: Callable[[], Pacing],
        progress: Progress,
        ready: Callable[[], None],
        *,
        start_ns: int = 0,
    ) -> Outcome:
        """Bring up, tick, bring down. ``ready`` is called between bring-up and the first tick,
        which comes no earlier than ``start_ns`` on the loop's clock.

        Raises a `DriverError` when the bus cannot be brought up; a fault in operation is an
        outcome, not an exception.
        """
        serving = asyncio.get_running_loop().create_task(self._serve_meanwhile())
        try:
            try:
                await self._fieldbus.start(progress)
            finally:
                serving.cancel()
            ready()
            scheduler = self.scheduler = self._schedule(pacing(), start_ns)
            try:
                ticks = await self._tick_until_done(scheduler)
            finally:
                scheduler.close()
                self._give_up_recovery()
        finally:
            await self._fieldbus.stop()
        sequence = self.cycle.sequence
        return Outcome(
            sequence.state,
            sequence.fault,
            self._reporter.fault or self._verdict(),
            ticks,
            scheduler.misses,
            self._overruns.stopped,
            self._commander.obstacle,
        )

    def _verdict(self) -> str:
        """What became of the scenario when nothing went wrong."""
        if self._overruns.stopped:
            return "stopped because ticks were missed, as realtime.overrun asks for"
        if self._commander.obstacle:
            return f"not armed: {self._commander.obstacle}"
        if self._commander.interrupted:
            return "stopped by the operator"
        played, asked = float(self.cycle.record.state.scenario_time), self._duration
        late = asked - played
        if late > _NOTICEABLE_S:
            return (
                f"time is up at {played:.1f} of {asked:.1f} s: the envelope held the scenario back"
            )
        return "scenario completed"

    async def _serve_meanwhile(self) -> None:
        while self.service is not _nobody:
            self._due_ns = now_ns()
            self.service(self._due_ns)
            await asyncio.sleep(_SERVICE_PERIOD_S)

    def _schedule(self, pacing: Pacing, start_ns: int) -> Scheduler:
        """The first tick is due on a whole period, at least one from now."""
        period_ns = self._config.control.rates.period_ns
        first_ns = (now_ns() // period_ns + 2) * period_ns
        return Scheduler(period_ns, max(first_ns, start_ns), pacing, self._stopwatch)

    async def _tick_until_done(self, scheduler: Scheduler) -> int:
        ticks = 0
        while not self._commander.finished:
            self._tick(await scheduler.next(), scheduler)
            ticks += 1
        return ticks

    def _tick(self, tick: int, scheduler: Scheduler) -> None:
        wall, fieldbus, cycle = self._stopwatch.wall_ns, self._fieldbus, self.cycle
        self._due_ns = due_ns = scheduler.due_ns(tick)
        began, used = wall(), self._stopwatch.processor_ns()
        fieldbus.collect(tick)
        self._tracker.collect(now_ns())
        collected = wall()
        command = self._command(tick, scheduler)
        select = self._commander.select
        cycle.act(fieldbus.image, tick, command, select)
        computed = wall()
        fieldbus.publish(tick)
        published = wall()
        used = self._stopwatch.processor_ns() - used
        record = cycle.write(fieldbus.image, tick, command, select)
        self._write_timing(scheduler, began, collected, computed, published)
        record.timing.processor_us[...] = used * 1e-3
        self._ring.publish(record.data, due_ns)
        if self._keyframes is not None:
            self._keep_state(tick, self._keyframes)
        self._report(tick, command)
        self._look(tick)
        self.service(due_ns)
        self._after_ns = wall() - published

    def _keep_state(self, tick: int, keyframes: KeyframeSink) -> None:
        """A keyframe now and then, a step a tick: more would overrun one."""
        if self._kept is None:
            if tick < self._keyframe_due:
                return
            self._keyframe_due = tick + self._keyframe_ticks
            self._kept = (self._due_ns, tick, self._keyframe.steps())
        due_ns, seen_in, steps = self._kept
        data = next(steps)
        if data:
            self._kept = None
            keyframes(due_ns, seen_in, data)

    def _write_timing(
        self, scheduler: Scheduler, began: int, collected: int, computed: int, published: int
    ) -> None:
        """``began`` to ``published`` in ns of the stopwatch."""
        timing, misses, found = self.cycle.record.timing, scheduler.misses, scheduler.disturbances
        timing.due_ns[...] = self._due_ns
        timing.missed_own[...] = misses.own
        timing.missed_host[...] = misses.host
        timing.page_faults[...] = found.page_faults
        timing.switches[...] = found.switches
        timing.wakeup_us[...] = scheduler.wakeup_ns * 1e-3
        timing.bus_us[...] = self._fieldbus.image.bus_ns * 1e-3
        timing.collect_us[...] = (collected - began) * 1e-3
        timing.compute_us[...] = (computed - collected) * 1e-3
        timing.publish_us[...] = (published - computed) * 1e-3
        timing.after_us[...] = self._after_ns * 1e-3
        if self._stopwatch.running:
            slack = self._due_ns + scheduler.period_ns - published
            timing.slack_us[...] = slack * 1e-3
            latencies = self.latencies
            latencies.wakeup.add(scheduler.wakeup_ns)
            latencies.compute.add(computed - collected)
            latencies.cycle.add(published - began)
            latencies.slack.add(slack)

    def _look(self, tick: int) -> None:
        """The self-test, as long as the robot is not armed."""
        if self.cycle.sequence.state is not State.STANDBY:
            self.self_test.forget()
            return
        age = self.self_test.age(tick)
        if age is None or age >= self.self_test.interval:
            self.self_test.look(self._fieldbus.image, self.cycle, tick)

    @property
    def recovering(self) -> bool:
        """A reset waits for devices that are being brought back."""
        return self._recovery is not None

    def note(self, level: Level, name: str, text: str) -> None:
        """An event of those who operate the daemon."""
        self._emit(int(self.cycle.record.timing.tick), level, name, "", text)

    def _command(self, tick: int, scheduler: Scheduler) -> Operator:
        """What the operator says, or the overrun policy in their place."""
        said = self._operator(tick)
        if not scheduler.skipped:
            return said
        command = self._overruns.answer(scheduler.skipped, self.cycle.sequence.state, said)
        if command is not said:
            misses = scheduler.misses
            text = (
                f"{scheduler.skipped} ticks missed at once ({misses.own} of our own making so far, "
                f"{misses.host} by the host); realtime.overrun asks for {command.name.lower()}"
            )
            self._emit(tick, Level.WARNING, "overrun", "scheduler", text)
        return command

    def _operator(self, tick: int) -> Operator:
        """What the operator says. Arming needs a good self-test. A reset in FAULT waits, while
        ticks go on, until the bus has brought back what it can; an emergency stop ends that wait
        and the reset with it."""
        command = self._commander.next(self.cycle.sequence)
        self._who = self._commander.who
        if command is Operator.ARM and self.cycle.sequence.state is State.STANDBY:
            obstacles = self.self_test.obstacles(tick)
            if obstacles:
                self._refuse(tick, "; ".join(obstacles))
                return Operator.NONE
            self._refused = ""
        if self._recovery is None:
            if command is not Operator.RESET or self.cycle.sequence.state is not State.FAULT:
                return command
            self._resetting_for = self._commander.who
            recovery = self._fieldbus.recover()
            self._recovery = asyncio.get_running_loop().create_task(recovery)
            return Operator.NONE
        if command is Operator.ESTOP:
            self._give_up_recovery()
            return command
        if not self._recovery.done():
            return Operator.NONE
        self._recovery.result()
        self._recovery = None
        self._who = self._resetting_for
        return Operator.RESET

    def _refuse(self, tick: int, reason: str) -> None:
        """Whoever asks again for the same reason is answered, and the log spared."""
        self._commander.refused(reason)
        if reason != self._refused:
            self._refused = reason
            who = self._commander.who
            text = f"arm{f' by {who}' if who else ''}: {reason}"
            self._emit(tick, Level.WARNING, "refused", "", text)

    def _give_up_recovery(self) -> None:
        if self._recovery is not None:
            self._recovery.cancel()
            self._recovery = None

    def _report(self, tick: int, command: Operator) -> None:
        """Events, in the ticks where there are any."""
        if command is not Operator.NONE:
            who = self._who
            text = f"{command.name.lower()}{f' by {who}' if who else ''}"
            self._emit(tick, Level.INFO, "operator", "", text)
        self._reporter.look(self._due_ns, tick)
        for source in (self._fieldbus, self._tracker):
            for event in source.take_events():
                self._emit(tick, Level.WARNING, event.name, event.where, event.text)

    def _emit(self, tick: int, level: Level, name: str, where: str, text: str) -> None:
        self._events(self._due_ns, tick, level, name, where, text)
