"""A run by its log, and what it has to have done."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import cached_property
from operator import methodcaller
from pathlib import Path

import numpy as np

from tonus.config.schema.bus import SHIPPED
from tonus.config.schema.faults import Fault
from tonus.runtime.recording.taps import Level
from tonus.runtime.signals import TABLE
from tonus.tools.campaign.invariants import within_bounds
from tonus.tools.campaign.observed import Observed, of_log
from tonus.tools.campaign.strikes import NS, Strike, strikes
from tonus.tools.errors import ToolError
from tonus.tools.expect.failure import ExpectationError
from tonus.tools.expect.found import Found
from tonus.tools.expect.names import advice, full, need_known
from tonus.tools.expect.signal import Signal
from tonus.tools.expect.timeline import Timeline
from tonus.tools.log.attached import configuration
from tonus.tools.log.log import Event, Log
from tonus.tools.log.replay import replay
from tonus.tools.run.summary import TRUTH, Summary, summarise
from tonus.tools.run.truth import TOPIC

__tracebackhide__ = methodcaller("errisinstance", ExpectationError)
"""For pytest: the line that asks is of interest, and not where the answer is found."""
_NEAREST = 3
"""events that a failed `Run.expect` names beside the one that it asked for"""
Injected = tuple[int, Fault]
"""A fault given to a lab by hand, and its time in ns on the log's clock."""


class Run:
    """Questions over one log. A question whose answer is not the expected one raises
    `ExpectationError`; one that the log cannot answer, and one for an event that there is none of,
    `ToolError`.

    ``reason`` is the daemon's own word for the end, where it is known; ``cut`` says that the run
    was left in the middle; ``injected`` are the faults that a test gave to the lab beside those of
    the scenario. Times are s since the log's first message, which is at 0 in virtual time.
    """

    def __init__(
        self, log: Log, *, reason: str = "", cut: bool = False, injected: Sequence[Injected] = ()
    ) -> None:
        self.log = log
        self.timeline = Timeline(log.start_ns)
        self._reason, self._cut, self._injected = reason, cut, injected
        self._expected: set[str] = set()

    @property
    def path(self) -> Path:
        """Of the log."""
        return self.log.path

    @cached_property
    def summary(self) -> Summary:
        """The keys of summary.json (docs/operation.md)."""
        return summarise(self.log, reason=self._reason or None)

    @property
    def state(self) -> str:
        """The last one, by name: STANDBY after a good end."""
        return str(self.summary["state"])

    @property
    def reason(self) -> str:
        """Why it ended."""
        return str(self.summary["reason"])

    @cached_property
    def events(self) -> list[Event]:
        """docs/events.md, in order of time."""
        return self.log.events()

    @cached_property
    def faults(self) -> list[Strike]:
        """Each fault of the lab that struck, in order of time: those of the scenario and those
        injected by hand. Without truth in the log, those injected by hand only."""
        found = list(self._observed.strikes) if TRUTH in self.log and self._ticked else []
        if self._injected:
            config = configuration(self.log)
            for at_ns, fault in self._injected:
                now = fault.model_copy(update={"at": 0.0})
                found += strikes(config, [now], at_ns + round(fault.at * NS), frozenset())
        return sorted(found, key=lambda strike: strike.at_ns)

    def expect(
        self,
        event: str,
        *,
        where: str = "",
        within: float | None = None,
        after: float | None = None,
    ) -> Found:
        """The first event of this name (``*`` and ``?`` as in file names) whose place or text has
        the words ``where``.

        It has to happen from ``after`` (s) on and, where given, within ``within`` s of it.
        ``after`` is the first fault of the lab if ``within`` is given, otherwise the log's start;
        `Found.after` is measured from it, or from the first fault. The name of the event found is
        expected from then on: `unexpected` leaves it out.
        """
        self._need_named(event, where)
        for name, value in (("within", within), ("after", after)):
            if value is not None and not (isinstance(value, int | float) and value >= 0.0):
                raise ToolError(f"{name}: {value!r} is not possible; give s, from 0 on")
        struck = self.timeline.seconds(self.faults[0].at_ns) if self.faults else 0.0
        since = after if after is not None else struck
        searched = since if after is not None or within is not None else 0.0
        place = f" at {where}" if where else ""
        for each in self._named(event, where):
            time = self.timeline.seconds(each.time_ns)
            if time < searched:
                continue
            self._expected.add(each.name)
            # To the ns: a difference of decimals may be larger than the decimal it stands for.
            took = round(time - since, 9)
            if within is not None and took > within:
                figure = (
                    f"{event}{place} came {took:.3f} s after {since:.3f} s, "
                    f"and not within {within:g} s"
                )
                raise self.failure(figure, time, since=searched or None)
            return Found(each, time, took)
        limits = f" after {searched:.3f} s" if searched else ""
        figure = f"no event {event}{place}{limits}{self._nearest(event)}"
        raise self.failure(figure, since=searched or None)

    def never(self, event: str, *, where: str = "") -> None:
        """No event of this name (``*`` and ``?`` as in file names) whose place or text has
        the words ``where``."""
        self._need_named(event, where)
        for each in self._named(event, where):
            time = self.timeline.seconds(each.time_ns)
            raise self.failure(f"{each.name} happened at {time:.3f} s, {each.where}", time)

    def allow(self, *events: str) -> None:
        """Let `unexpected` leave out events of these names (``*`` and ``?`` as in file names),
        whether they happen or not."""
        for event in events:
            self._need_named(event)
        self._expected.update(events)

    def unexpected(self, expected: Iterable[str] = ()) -> list[Event]:
        """Warnings and errors that no `expect`, no `allow` and none of the names in ``expected``
        speak of."""
        names = {*self._expected, *expected}
        return [
            event
            for event in self.events
            if event.level >= Level.WARNING
            and not any(fnmatchcase(event.name, name) for name in names)
        ]

    def undisturbed(self, expected: Iterable[str] = ()) -> None:
        """No warning and no error that is `unexpected`."""
        found = self.unexpected(expected)
        if found:
            names = ", ".join(dict.fromkeys(event.name for event in found))
            time = self.timeline.seconds(found[0].time_ns)
            figure = f"{len(found)} unexpected warnings or errors from {time:.3f} s on: {names}"
            raise self.failure(figure, since=time)

    def signal(self, topic: str, field: str) -> Signal:
        """A signal of docs/log.md. ``topic`` may leave out ``/tonus/``. Raises `ToolError` where
        the log has no such signal."""
        name = full(topic)
        if not self.log.has(name, field):
            hint = advice(name, field)
            where, remedy = ("", hint) if hint else (f"{self.path}: ", "docs/log.md lists them")
            raise ToolError(f"{where}there is no signal {name}.{field}; {remedy}")
        self.log.load([name, "/tonus/state"])
        times = self.log.times(name)
        last = np.searchsorted(self.log.times("/tonus/state"), times, side="right") - 1
        states = self.log["/tonus/state"]["state"]
        states = np.where(last >= 0, states[np.maximum(last, 0)], 0).astype(np.uint8)
        seconds = (times - self.timeline.start_ns) / NS
        values = np.asarray(self.log[name][field], dtype=np.float64)
        short = name.removeprefix("/tonus/")
        return Signal(f"{short}.{field}", _unit(name, field), seconds, values, states, self.failure)

    def invariants(self, *, replayed: bool = False) -> None:
        """What no run in the lab may do, whatever fault it had: the rules of the fault campaign
        (docs/campaign.md), judged by the plant's truth; of a run that was left in the middle all
        but its end. ``replayed``: `replays`, too. Raises `ToolError` for a log without truth."""
        found = within_bounds(replace(self._observed, strikes=self.faults, cut=self._cut))
        if found:
            times = [self.timeline.seconds(round(each.at_s * NS)) for each in found]
            told = [replace(each, at_s=time) for each, time in zip(found, times, strict=True)]
            raise self.failure("; ".join(map(str, told)), times[0])
        if replayed:
            self.replays()

    def replays(self, *, gaps: bool = False) -> None:
        """The recorded inputs give every recorded output again, bit for bit. ``gaps``: ticks that
        no recorded state leads up to, as at the start of a log cut out of a longer one, may be left
        out."""
        if self.log.damage:
            raise self.failure(f"the log is damaged: {self.log.damage}")
        found = replay(self.log)
        if not found.ticks:
            raise self.failure("the log has no tick that could be replayed")
        if found.unchecked and not gaps:
            first, last = found.unchecked[0]
            figure = f"ticks {first} to {last} (and {len(found.unchecked) - 1} other stretches)"
            figure += " cannot be replayed: records are missing before them"
            raise self.failure(figure, self._time_of(first))
        if found.first is not None:
            one = found.first
            figure = f"{one.place} was {one.recorded!r} and is replayed as {one.replayed!r}"
            raise self.failure(f"{figure}, first in tick {one.tick}", self._time_of(one.tick))

    def failure(
        self, figure: str, time: float | None = None, *, since: float | None = None
    ) -> ExpectationError:
        """The error to raise for a figure at a time (s); None: of the whole run. ``since``: the
        time (s) from which on something was expected."""
        return ExpectationError(figure, self.timeline, self.events, time, since)

    @property
    def _ticked(self) -> bool:
        """A daemon that could not bring the bus up has recorded no tick."""
        return "/tonus/timing" in self.log

    @cached_property
    def _observed(self) -> Observed:
        return of_log(self.log)

    def _need_named(self, event: str, where: str = "") -> None:
        """Raises `ToolError` for a name that neither Tonus nor a fieldbus of somebody else has."""
        for key, value in (("event", event), ("where", where)):
            if not isinstance(value, str):
                raise ToolError(f"{key}: {value!r} is no text; put it into quotes")
        if any(each.name == event for each in self.events):
            return
        if all(bus.kind in SHIPPED for bus in configuration(self.log).fieldbus.parts):
            need_known(event)

    def _nearest(self, event: str) -> str:
        """Those of this name that came at another place or too early, the first at each place."""
        first: dict[str, str] = {}
        for each in self._named(event, ""):
            told = each.where or each.text
            time = self.timeline.seconds(each.time_ns)
            first.setdefault(f"{each.name} {told}", f"{each.name} at {told} came at {time:.3f} s")
        more = f"; {len(first) - _NEAREST} more" if len(first) > _NEAREST else ""
        return "".join(f"; {each}" for each in list(first.values())[:_NEAREST]) + more

    def _named(self, name: str, where: str) -> list[Event]:
        return [
            event for event in self.events if fnmatchcase(event.name, name) and _tells(event, where)
        ]

    def _time_of(self, tick: int) -> float | None:
        rows = np.flatnonzero(self.log["/tonus/timing"]["tick"] == tick)
        if not len(rows):
            return None
        return self.timeline.seconds(int(self.log.times("/tonus/timing")[rows[0]]))


def _tells(event: Event, where: str) -> bool:
    """Whether its place or text has these words; "axis 1" is not in "axis 12"."""
    pattern = rf"(?<!\w){re.escape(where)}(?!\w)"
    return not where or any(re.search(pattern, told) for told in (event.where, event.text))


def _unit(topic: str, field: str) -> str:
    for each in (*TABLE, TOPIC):
        if each.name == topic:
            for one in each.fields:
                if one.name == field:
                    return one.unit
    return ""
