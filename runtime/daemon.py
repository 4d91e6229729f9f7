"""The daemon: one bus, one tick, one record, until the commander is done.

    collect → act → publish → write → record

All that is slow (bring-up, files, people) lies before, after or outside the ticks.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.drivers.fieldbus import Fieldbus, Progress
from tonus.runtime.control.tuning import GainChange
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.operation.brakes import BrakeWatch
from tonus.runtime.operation.operator import Commander
from tonus.runtime.operation.orders import Orders
from tonus.runtime.operation.reporter import EventSink, Reporter
from tonus.runtime.operation.self_test import SelfTest
from tonus.runtime.ports import ALL, Recorded, Ring, TrackerDoor
from tonus.runtime.recording.keyframe_keeper import KeyframeKeeper, KeyframeSink
from tonus.runtime.recording.taps import Level
from tonus.runtime.safety.fallback import Fallback
from tonus.runtime.safety.firewall import Firewall, Part, in_one_line
from tonus.runtime.safety.guarded_parts import GuardedParts
from tonus.runtime.signals import CycleRecord
from tonus.runtime.states import ARMED, Fault, Operator, State
from tonus.runtime.timing.clock import Stopwatch, loop_clock, now_ns
from tonus.runtime.timing.latencies import Latencies, Marks
from tonus.runtime.timing.overruns import Overruns
from tonus.runtime.timing.scheduler import Misses, Pacing, Scheduler
from tonus.runtime.words import axis_name, describe

_NOTICEABLE_S = 0.5
"""Slowing at the start and at the end takes a tenth of a second; more was the envelope."""
_SERVICE_PERIOD_S = 0.02
"""between two looks at the control socket while the bus is brought up"""


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
        firewall: Firewall | None = None,
        recorded: Recorded = ALL,
    ) -> None:
        """``others``: scenarios that may be chosen instead, by their numbers from 1 on;
        ``firewall``: one that guards parts outside the daemon too; ``recorded``: what of the run
        goes into ``ring``."""
        self._config = config
        self._fieldbus, self._tracker, self._commander = fieldbus, tracker, commander
        self._ring, self._events, self._stopwatch = ring, events, stopwatch
        references = [other.reference for other in others]
        self.cycle = ControlCycle(
            config.robot,
            config.control,
            config.tracker,
            scenario.reference,
            references,
            config.operation.tunable,
        )
        self.cycle.lean = recorded.lean
        self._recorded = recorded
        self.firewall = firewall or Firewall(config.operation.firewall.failures)
        self._guard = GuardedParts(self.firewall)
        self._fallback = Fallback(config, self.cycle, self._guard.fallback)
        self._reporter = Reporter(config, self.cycle, fieldbus.image, self._send)
        self._brakes = BrakeWatch(config)
        self.self_test = SelfTest(config, self._brakes)
        self.scheduler: Scheduler | None = None
        """there is one once the bus is up"""
        self._services: list[tuple[Part, Callable[[int], None]]] = []
        self._duration = scenario.duration
        self._keeper: KeyframeKeeper | None = None
        if keyframes is not None:
            ticks = round(config.recording.keyframe_s / config.control.rates.period)
            self._keeper = KeyframeKeeper(self.cycle, keyframes, ticks)
        self._due_ns = self._after_ns = self._ticks = 0
        self._now_ns = now_ns
        self._overruns = Overruns(config.realtime)
        self.latencies = Latencies()
        self._halted = False
        """while the bus was brought up"""
        self._orders = Orders(
            commander, self.cycle.sequence, self.self_test, self._overruns, fieldbus, self._emit
        )

    def prepare_to_go_on(self) -> None:
        """Between two ticks: have the keyframe ready that `go_on` begins with, if no tick comes
        before."""
        if self._keeper is not None:
            self._keeper.prepare()

    def last(self, duration: float) -> None:
        """Have the scenario last ``duration`` s."""
        self._duration = duration

    def go_on(self, duration: float) -> None:
        """Between two ticks: what is recorded from here on is a run of its own, whose scenario
        lasts ``duration`` s. It begins with the last tick's record, if that is recorded, and a
        keyframe."""
        self.last(duration)
        record = self.cycle.record
        if not self._leaves_unwritten(self._due_ns):
            self._ring.publish(record.data, self._due_ns)
        if self._keeper is not None:
            self._keeper.now(self._due_ns, int(record.timing.tick))

    def serve(self, name: str, action: Callable[[int], None], *, lasting: bool = False) -> None:
        """Call ``action`` with the due time (ns) after each tick, and now and then before the
        first: people are served then, in bounded time. A ``lasting`` one is never switched off."""
        self._services.append((self.firewall.part(name, lasting=lasting), action))

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
        try:
            self._now_ns = loop_clock()
            if await self._bring_up(progress):
                ready()
                scheduler = self.scheduler = self._schedule(pacing(), start_ns)
                try:
                    await self._tick_until_done(scheduler)
                finally:
                    scheduler.close()
                    self._orders.give_up_recovery()
        finally:
            await self._fieldbus.stop()
            sys.stderr.write(self.firewall.tracebacks())
        return self.outcome

    @property
    def outcome(self) -> Outcome:
        """How the run has ended, or would if it ended now."""
        sequence, scheduler = self.cycle.sequence, self.scheduler
        return Outcome(
            sequence.state,
            sequence.fault,
            self._reporter.fault or self._verdict(),
            self._ticks,
            scheduler.misses if scheduler is not None else Misses(),
            self._overruns.stopped,
            self._commander.obstacle,
        )

    async def _bring_up(self, progress: Progress) -> bool:
        """Whether the bus is up; a signal or an emergency stop ends the bring-up."""
        task = asyncio.current_task()
        assert task is not None
        serving = asyncio.get_running_loop().create_task(self._serve_meanwhile(task))
        try:
            await self._fieldbus.start(progress)
        except asyncio.CancelledError:
            if not self._halted:
                raise
            task.uncancel()
        finally:
            serving.cancel()
        return not self._halted

    def _verdict(self) -> str:
        """The outcome of the scenario: completed, stopped, or the fault."""
        sequence = self.cycle.sequence
        if sequence.fault is not Fault.NONE:
            return describe(self._config, sequence.fault, sequence.where, sequence.reason)
        if self._guard.commander.failing:
            return "stopped because what commands the run failed"
        if self._overruns.stopped:
            return "stopped because ticks were missed (realtime.overrun)"
        if self._commander.obstacle:
            return f"not armed: {self._commander.obstacle}"
        if self._halted:
            return "stopped by the operator while the bus was brought up"
        if self._commander.interrupted:
            return "stopped by the operator"
        played, asked = self.cycle.scenario_time, self._duration
        late = asked - played
        if late > _NOTICEABLE_S:
            return (
                f"time is up at {played:.1f} of {asked:.1f} s: the envelope held the scenario back"
            )
        return "scenario completed"

    async def _serve_meanwhile(self, starting: asyncio.Task[Any]) -> None:
        """Serve people until ``starting`` has brought the bus up; cancel it when asked to."""
        while self._services and not self._halted:
            self._due_ns = now_ns()
            self._serve_all()
            if self._guard.commander.call(lambda: self._commander.urgent):
                self._halt(starting)
            await asyncio.sleep(_SERVICE_PERIOD_S)

    def _halt(self, starting: asyncio.Task[Any]) -> None:
        guard, sequence = self._guard, self.cycle.sequence
        command = guard.commander.call(self._commander.next, sequence)
        self._orders.who = self._commander.who
        if command is Operator.ESTOP:
            sequence.stop_before_ticks()
        self._report(0, command or Operator.NONE)
        self._serve_all()  # so that an emergency stop is answered
        self._halted = True
        starting.cancel()

    def _serve_all(self) -> None:
        for part, action in self._services:
            part.call(action, self._due_ns)

    def _schedule(self, pacing: Pacing, start_ns: int) -> Scheduler:
        """The first tick is due on a whole period, at least one from now."""
        period_ns = self._config.control.rates.period_ns
        first_ns = (now_ns() // period_ns + 2) * period_ns
        return Scheduler(period_ns, max(first_ns, start_ns), pacing, self._stopwatch)

    async def _tick_until_done(self, scheduler: Scheduler) -> None:
        while not self._finished:
            self._tick(await scheduler.next(), scheduler)
            self._ticks += 1

    @property
    def _finished(self) -> bool:
        """By its commander; where that or control failed, once the drives are disabled."""
        if self._fallback.active:
            return self._fallback.over
        if self._guard.commander.failing:
            return self.cycle.sequence.state not in ARMED
        return self._commander.finished

    def _tick(self, tick: int, scheduler: Scheduler) -> None:
        wall, fieldbus, cycle = self._stopwatch.wall_ns, self._fieldbus, self.cycle
        self._due_ns = due_ns = scheduler.due_ns(tick)
        began, used = wall(), self._stopwatch.processor_ns()
        fieldbus.collect(tick)
        self._collect_tracker()
        collected = wall()
        command = self._command(tick, scheduler)
        self._act(tick, command, self._orders.select, self._orders.change)
        computed = wall()
        fieldbus.publish(tick)
        published = wall()
        used = self._stopwatch.processor_ns() - used
        self._judge(tick)
        guard = self._guard
        if self._leaves_unwritten(due_ns):
            guard.record.call(cycle.leave_unwritten)
        else:
            marks = Marks(began, collected, computed, published)
            self._record(tick, command, scheduler, marks, used)
        if self._keeper is not None:
            guard.keyframe.call(self._keeper, due_ns, tick)
        self._report(tick, command)
        guard.self_test.call(self._look, tick)
        self._serve_all()
        self._after_ns = wall() - published

    def _leaves_unwritten(self, due_ns: int) -> bool:
        """Whether the tick that was due then is none of those that are recorded."""
        recorded = self._recorded
        if recorded is ALL:
            return False
        period = due_ns // self._config.control.rates.period_ns
        return period % recorded.stride != 0 or self.cycle.sequence.state not in recorded.states

    def _record(
        self, tick: int, command: Operator, scheduler: Scheduler, marks: Marks, used_ns: int
    ) -> None:
        guard, orders, image = self._guard, self._orders, self._fieldbus.image
        record = guard.record.call(
            self.cycle.write, image, tick, command, orders.select, orders.change
        )
        if record is not None:
            if not self._recorded.lean:
                guard.record.call(self._write_timing, record, scheduler, marks, used_ns)
            guard.ring.call(self._ring.publish, record.data, self._due_ns)

    def _write_timing(
        self, record: CycleRecord, scheduler: Scheduler, marks: Marks, used_ns: int
    ) -> None:
        others = (self._fieldbus.image.bus_ns, used_ns, self._after_ns)
        measured = self._stopwatch.running
        self.latencies.write(record, scheduler, marks, self._due_ns, others, measured=measured)

    def _collect_tracker(self) -> None:
        """Without one the pose is as old as the last that came."""
        tracker, part = self._fieldbus.image.tracker, self._guard.tracker
        failures = part.failures
        part.call(self._tracker.collect, self._now_ns())
        if part.failures > failures:
            tracker["fresh"] = 0
            tracker["delay"] += self._config.control.rates.period

    def _act(self, tick: int, command: Operator, select: int, change: GainChange) -> None:
        """Control; once it has raised, its passive fallback in its place."""
        image, fallback = self._fieldbus.image, self._fallback
        if not fallback.active:
            try:
                self.cycle.act(image, tick, command, select, change)
            except Exception as error:  # noqa: BLE001 - power off at height would be worse
                self._failed(error, tick)
            else:
                return
        fallback.step(image, tick, disable=command is Operator.ESTOP)

    def _judge(self, tick: int) -> None:
        """Of the tick whose outputs are sent; what it raises is control's, answered in the next."""
        if self._fallback.active:
            return
        try:
            self.cycle.judge(self._fieldbus.image)
        except Exception as error:  # noqa: BLE001 - as in `_act`
            self._failed(error, tick)

    def _failed(self, error: Exception, tick: int) -> None:
        self._guard.control.failed(error)
        self._fallback.begin(in_one_line(error), tick)

    def _look(self, tick: int) -> None:
        """The brakes, and the self-test as long as the robot is not armed."""
        for axis, slip in self._brakes.look(self._fieldbus.image, tick):
            text = f"its cable went by {1e3 * slip:.0f} mm with the brake closed"
            name = axis_name(self._config, axis)
            self._emit(tick, Level.ERROR, "brake_slipped", name, text)
        if self.cycle.sequence.state is not State.STANDBY:
            self.self_test.forget()
            return
        age = self.self_test.age(tick)
        if age is None or age >= self.self_test.interval:
            self.self_test.look(self._fieldbus.image, self.cycle, tick)

    @property
    def recovering(self) -> bool:
        """A reset waits for devices that are being brought back."""
        return self._orders.recovering

    def note(self, level: Level, name: str, text: str) -> None:
        """An event of those who operate the daemon."""
        self._emit(int(self.cycle.record.timing.tick), level, name, "", text)

    def _command(self, tick: int, scheduler: Scheduler) -> Operator:
        """This tick's command; a controlled stop where what gives commands keeps failing."""
        part = self._guard.commander
        command = part.call(self._orders.next, tick, scheduler)
        if command is not None:
            return command
        self._orders.who, state = "", self.cycle.sequence.state
        stop = part.failing and state in ARMED and state is not State.SAFE_STOP
        return Operator.STOP if stop else Operator.NONE

    def _report(self, tick: int, command: Operator) -> None:
        """Events, in the ticks where there are any."""
        if command is not Operator.NONE:
            who = self._orders.who
            text = f"{command.name.lower()}{f' by {who}' if who else ''}"
            self._emit(tick, Level.INFO, "operator", "", text)
        if self._orders.change.number:
            self._report_change(tick, self._orders.change)
        guard = self._guard
        guard.reporter.call(self._reporter.look, self._due_ns, tick)
        for part, source in ((guard.bus_events, self._fieldbus), (guard.tracker, self._tracker)):
            for event in part.call(source.take_events) or ():
                self._emit(tick, Level.WARNING, event.name, event.where, event.text)
        for event in self.firewall.take_events():
            self._emit(tick, Level.ERROR, event.name, event.where, event.text)

    def _report_change(self, tick: int, change: GainChange) -> None:
        tuning, who = self.cycle.tuning, self._orders.who
        key = tuning.keys[change.number - 1]
        if tuning.accepted(change):
            text = f"from {tuning.before:g} to {change.value:g} by {who}"
            self._emit(tick, Level.INFO, "tuned", key, text)
            return
        reason, _ = tuning.against(change, self.cycle.sequence.state)
        self._emit(tick, Level.WARNING, "refused", "", f"set {key} by {who}: {reason}")

    def _emit(self, tick: int, level: Level, name: str, where: str, text: str) -> None:
        self._send(self._due_ns, tick, level, name, where, text)

    def _send(
        self, stamp_ns: int, tick: int, level: Level, name: str, where: str, text: str
    ) -> None:
        self._guard.events.call(self._events, stamp_ns, tick, level, name, where, text)
