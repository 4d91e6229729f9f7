"""What changes in the cycle from one tick to the next, told as events."""

from __future__ import annotations

from typing import Protocol

from tonus.config.schema.root import Config
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.recording.taps import Level
from tonus.runtime.signals import Consistency, Grade
from tonus.runtime.states import ARMED, Fault, State, StopMode
from tonus.runtime.words import STOP_TEXT, axis_name, describe, place, reaction

_CONSISTENCY = {
    Consistency.GOOD: "lengths, tensions and tracker fit together again",
    Consistency.CABLES: "the cable lengths contradict each other or the motion",
    Consistency.TRACKER: "the tracker's poses are refused",
    Consistency.SINGULAR: "the cables hardly determine the pose",
}


class EventSink(Protocol):
    """Where events go."""

    def __call__(
        self, stamp_ns: int, tick: int, level: Level, name: str, where: str, text: str
    ) -> None: ...


class Reporter:
    """Looks at each tick and reports what is new, once."""

    def __init__(
        self, config: Config, cycle: ControlCycle, image: ProcessImage, events: EventSink
    ) -> None:
        self._config, self._events = config, events
        self._cycle, self._sequence, self._tracker = cycle, cycle.sequence, image.tracker
        self._drums, self._blind = cycle.drums, False
        seconds = config.control.isolation.unobserved_s
        self._blind_ticks = round(seconds / config.control.rates.period)
        self.fault = ""
        """the present one in words, and what is done about it; empty: there is none"""
        self._stamp_ns = self._tick = 0
        self._state = State.OFF
        self._grade = Grade.GREEN
        self._fault = Fault.NONE
        self._count, self._known = 0, cycle.sequence.faults.found.copy()
        self._stop = StopMode.NONE
        self._short = False
        self._slack: list[int] = []
        self._consistency, self._learnt = Consistency.GOOD, 0
        self._tracker_tick, self._tracker_silent = 0, False
        patience = config.tracker.maximum_age_ms * 1e-3 / config.control.rates.period
        self._tracker_patience = int(patience)

    def look(self, stamp_ns: int, tick: int) -> None:
        """At what the cycle has just made of the tick; events are stamped ``stamp_ns``."""
        self._stamp_ns, self._tick = stamp_ns, tick
        sequence = self._sequence
        if sequence.fault is not self._fault:
            self._report_fault()
        if sequence.faults.count != self._count:
            self._report_more()
        if sequence.stop_mode is not self._stop:
            self._stop = sequence.stop_mode
            if self._stop is not StopMode.NONE:
                level = Level.INFO if self._stop is StopMode.ON_PATH else Level.WARNING
                text = f"{self._stop.name.lower()}: {STOP_TEXT[self._stop]}"
                self._tell(level, "stop_mode", "", text)
        if sequence.state is not self._state:
            before, self._state = self._state, sequence.state
            self._tell(Level.INFO, "state", "", f"{before.name} to {sequence.state.name}")
        regulating = sequence.regulating
        if regulating:
            self._watch_envelope()
        # Where nothing is estimated no pose is accepted either.
        used = self._cycle.accepted if regulating else bool(self._tracker["fresh"])
        self._watch_tracker(used)
        if regulating:
            self._watch_estimator()
            self._watch_deficit()
        if sequence.waits_for != self._slack:
            self._report_slack()
        self._watch_drums()

    def _report_slack(self) -> None:
        """Cables for which referencing waits, each once an arming or each time that it slackens."""
        low = self._config.control.tension.slack
        before, self._slack = self._slack, self._sequence.waits_for
        for cable in self._slack:
            if cable not in before:
                at = axis_name(self._config, cable)
                text = f"{at}: the cable is slack; the others wait with {low:g} N until it pulls"
                self._tell(Level.WARNING, "cable_slack", at, text)

    def _watch_envelope(self) -> None:
        grade = self._cycle.grade
        if grade is not self._grade:
            self._grade = grade
            level = Level.INFO if grade is Grade.GREEN else Level.WARNING
            self._tell(level, "envelope", "", f"grade {grade.name.lower()}")

    def _watch_tracker(self, used: bool) -> None:
        """Without poses the estimator runs on the cables alone: a degraded mode, and said so."""
        if used:
            if self._tracker_silent:
                self._tell(Level.INFO, "tracker_back", "tracker", "poses are used again")
            self._tracker_tick, self._tracker_silent = self._tick, False
        elif self._tick - self._tracker_tick > self._tracker_patience and not self._tracker_silent:
            self._tracker_silent = True
            text = "no usable pose; the estimate uses the cables alone"
            self._tell(Level.WARNING, "tracker_lost", "tracker", text)

    def _watch_estimator(self) -> None:
        """Measurements that contradict each other, and what the estimator made of it."""
        consistency, disagreement = self._cycle.consistency, self._cycle.disagreement
        learnt = disagreement.learnt
        if consistency is not self._consistency:
            self._consistency = consistency
            level = Level.INFO if consistency is Consistency.GOOD else Level.WARNING
            text = _CONSISTENCY[consistency]
            if consistency is Consistency.TRACKER:
                text += f", {1e3 * disagreement.distance:.1f} mm away"
            self._tell(level, f"pose_{consistency.name.lower()}", "estimator", text)
        if learnt > self._learnt:
            away = f"{1e3 * disagreement.distance:.1f} mm"
            text = f"the tracker stays {away} away: the cable lengths are referenced again"
            self._tell(Level.WARNING, "tracker_learnt", "estimator", text)
        self._learnt = learnt

    def _watch_deficit(self) -> None:
        """A wrench the cables cannot deliver inside their bounds: said once an episode."""
        deficit = self._cycle.deficit
        short = deficit > self._config.control.distribution.deficit_limit
        if short and not self._short:
            text = f"{deficit:.1f} N of the commanded wrench cannot be delivered"
            self._tell(Level.WARNING, "wrench_deficit", "", text)
        self._short = short

    def _watch_drums(self) -> None:
        """Where samples come late too often, a jammed or slipping drum would not be found by its
        torque."""
        longest = self._drums.longest_unobserved
        if self._blind and longest == 0:
            self._blind = False
            self._tell(Level.INFO, "drums_observed", "", "torque and motion are compared again")
        elif not self._blind and longest > self._blind_ticks:
            self._blind = True
            axis = int(self._drums.unobserved.argmax())
            text = "samples are late or of uncertain time: torque and motion cannot be compared"
            self._tell(Level.WARNING, "drums_unobserved", f"axis {axis}", text)

    def _report_fault(self) -> None:
        sequence = self._sequence
        fault = self._fault = sequence.fault
        if fault is Fault.NONE:
            self.fault = ""
            return
        at = place(self._config, fault, sequence.where)
        answer = reaction(fault, armed=self._state in ARMED)
        self.fault = f"{describe(self._config, fault, sequence.where, sequence.reason)}; {answer}"
        self._tell(Level.ERROR, fault.name.lower(), at, self.fault)

    def _report_more(self) -> None:
        """What was found after the first fault: the stop goes on with what is left."""
        faults = self._sequence.faults
        new = faults.found & ~self._known
        self._count, self._known[:] = faults.count, faults.found
        for row, column in zip(*new.nonzero(), strict=True):
            fault, where = Fault(int(row)), int(column) - 1
            if (fault, where) != (faults.first, faults.where):
                text = describe(self._config, fault, where)
                at = place(self._config, fault, where)
                self._tell(Level.WARNING, fault.name.lower(), at, f"{text}; found while stopping")

    def _tell(self, level: Level, name: str, where: str, text: str) -> None:
        self._events(self._stamp_ns, self._tick, level, name, where, text)
