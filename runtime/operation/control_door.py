"""What may be asked of a running daemon, and what it answers: the verbs behind the control socket.

A request is one JSON object, ``{"op": ...}``, and so is its reply. That has ``"ok"``: true, or
false with ``"error"`` (what stands against it) and ``"next"`` (what to do). A command is given to
the next tick and answered after it, so that the reply tells what became of it.
"""

from __future__ import annotations

import json
import math
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.runtime.control.tuning import NO_CHANGE, GainChange
from tonus.runtime.daemon import Daemon
from tonus.runtime.operation.operator import Console
from tonus.runtime.operation.verbs import VERBS, Verb
from tonus.runtime.recording.taps import Level
from tonus.runtime.signals import Grade
from tonus.runtime.states import (
    ARMED,
    MEANING,
    MOVES,
    NEXT,
    TRANSITIONS,
    Event,
    Fault,
    Operator,
    State,
)
from tonus.runtime.words import describe

Reply = dict[str, Any]
_LINE = 400
"""characters of an error; it may quote what came"""
_OF_A_SCRIPT = (Operator.STOP, Operator.ESTOP)
_SCRIPTED = ("a script runs this daemon", "stop it, and start the daemon with --serve")
_SPARE = "give one JSON object with op, and name for a scenario"
_FIELDS = {"scenario": {"name"}, "set": {"key", "value"}}
"""of a request, beside op"""

STATUS: dict[str, tuple[str, str]] = {
    "config": ("string", "name of the configuration"),
    "controller": ("string", "name of the controller"),
    "served": ("boolean", "waits for commands; false: a script gives them"),
    "state": ("string", "of the state machine (states.md)"),
    "meaning": ("string", "that state in words"),
    "next": ("string", "what an operator may do"),
    "armed": ("boolean", "drives are enabled"),
    "recovering": ("boolean", "a reset waits for devices that are being brought back"),
    "elapsed_s": ("number", "in this state"),
    "tick": ("integer", "number of the last tick"),
    "fault": ("string or null", "where, what and why"),
    "scenario": ("string", "what START plays"),
    "scenario_s": ("number", "of it played so far"),
    "duration_s": ("number", "of it in all"),
    "scenarios": ("array of string", "what may be chosen"),
    "self_test": ("array of object", "item, ok, text; empty while the robot is armed"),
    "tunable": ("array of object", "key, value in force, target, minimum, maximum, step, rate"),
    "k_eq_n_per_m": ("number", "equivalent stiffness"),
    "tension_n": ("array of number", "of the cables"),
    "contact_n": ("number", "at the contact port"),
    "position_m": ("array of number", "of the platform, estimated"),
    "grade": ("string", "of the safety envelope"),
    "missed_own": ("integer", "ticks missed by our own making"),
    "missed_host": ("integer", "ticks missed by late wake-ups of the host"),
    "wakeup_us": ("number", "how late the last tick began"),
    "log": ("string", "where the recorder began this run"),
}
"""Every field of a status, beside `ok` and `op`: JSON type and meaning."""


@dataclass
class _Awaited:
    verb: Verb
    before: State
    select: int
    change: GainChange = NO_CHANGE


class ControlDoor:
    """Answers for one daemon. ``catalogue``: what may be chosen, the first one in force."""

    def __init__(
        self,
        config: Config,
        daemon: Daemon,
        console: Console,
        catalogue: Sequence[Scenario],
        log: str,
    ) -> None:
        self._config, self._daemon, self._console, self._log = config, daemon, console, log
        self._catalogue = catalogue
        self._names = [scenario.name for scenario in catalogue]
        self._awaited: _Awaited | None = None
        self._stop_awaited: _Awaited | None = None

    def answer(self, message: bytes, who: str, *, overtaken: bool = False) -> Reply | None:
        """The reply to a message of ``who``, whatever its bytes are; None: ask `later`.
        ``overtaken`` by an emergency stop, a command is refused."""
        try:
            request = json.loads(message)
        except UnicodeDecodeError:
            return refusal("the message is not UTF-8", _SPARE)
        except (ValueError, RecursionError) as error:
            return refusal(f"the message is not JSON: {error}", _SPARE)
        if not isinstance(request, dict):
            return refusal(f"a request is a JSON object, not {reprlib.repr(request)}", _SPARE)
        op = request.get("op")
        verb = VERBS.get(op) if isinstance(op, str) else None
        if verb is None:
            there = f"there is no op {reprlib.repr(op)}" if "op" in request else "op is missing"
            return refusal(there, f"choose one of {', '.join(VERBS)}")
        unknown = sorted(request.keys() - {"op"} - _FIELDS.get(verb.name, set()))
        if unknown:
            return refusal(f"{reprlib.repr(unknown[0])} is not a field of {op}", "remove it")
        if verb.name == "status":
            return self._status()
        if overtaken:
            state, late = self._daemon.cycle.sequence.state, "an emergency stop came after it"
            self._daemon.note(Level.WARNING, "refused", f"{verb.name} by {who}: {late}")
            return self._refusal(verb, state, late, NEXT[state])
        if verb.name == "set":
            return self._tune(verb, request.get("key"), request.get("value"), who)
        return self._order(verb, request.get("name"), who)

    def emergency(self, who: str) -> None:
        """The next tick disables every drive."""
        if self._stop_awaited is None:
            state = self._daemon.cycle.sequence.state
            self._stop_awaited = _Awaited(VERBS["estop"], state, 0)
        self._console.give(Operator.ESTOP, who)

    def stopped(self) -> Reply | None:
        """The reply to emergency stops, once a tick has taken them."""
        awaited = self._stop_awaited
        if awaited is None or self._console.pending:
            return None
        self._stop_awaited = None
        return self._became(awaited)

    def _order(self, verb: Verb, name: object, who: str) -> Reply | None:
        state = self._daemon.cycle.sequence.state
        select = 0
        if verb.name == "scenario":
            error, remedy, select = self._choose(state, name)
        else:
            error, remedy = self._against(verb.operator, state)
        if error:
            self._daemon.note(Level.WARNING, "refused", f"{verb.name} by {who}: {error}")
            return self._refusal(verb, state, error, remedy)
        if verb.operator is Operator.START and self._finished:
            select = self._chosen + 1  # once more, from its beginning
        if verb.operator is Operator.NONE:
            self._daemon.note(Level.INFO, "operator", f"scenario {name} by {who}")
        self._console.give(verb.operator, who, select)
        self._awaited = _Awaited(verb, state, select)
        return None

    def _tune(self, verb: Verb, key: object, value: object, who: str) -> Reply | None:
        state = self._daemon.cycle.sequence.state
        change, error, remedy = self._changed(state, key, value)
        if error:
            what = f"set {reprlib.repr(key)} by {who}"
            self._daemon.note(Level.WARNING, "refused", f"{what}: {error}")
            return self._refusal(verb, state, error, remedy)
        self._console.give(Operator.NONE, who, change=change)
        self._awaited = _Awaited(verb, state, 0, change)
        return None

    def _changed(self, state: State, key: object, value: object) -> tuple[GainChange, str, str]:
        """The change asked for, what stands against it, and what to do instead."""
        tuning = self._daemon.cycle.tuning
        if self._console.script is not None:
            return NO_CHANGE, *_SCRIPTED
        if key not in tuning.keys:
            said = "key is missing" if key is None else f"{reprlib.repr(key)} cannot be changed"
            there = ", ".join(tuning.keys)
            remedy = f"choose one of {there}" if there else "operation.tunable lists none"
            return NO_CHANGE, said, remedy
        if isinstance(value, bool) or not isinstance(value, int | float):
            said = "value is missing" if value is None else f"{reprlib.repr(value)} is no number"
            return NO_CHANGE, said, "give a number"
        number = tuning.keys.index(str(key)) + 1
        try:
            change = GainChange(number, float(value))
        except OverflowError:
            change = GainChange(number, math.inf)
        return change, *tuning.against(change, state)

    def _against(self, operator: Operator, state: State) -> tuple[str, str]:
        """What stands against a command and what to do instead; empty for nothing."""
        if operator is Operator.ESTOP:
            return "", ""
        console, daemon = self._console, self._daemon
        if console.script is not None and operator not in _OF_A_SCRIPT:
            return _SCRIPTED
        if console.ending:
            return "the daemon is about to end", "start it again"
        if daemon.scheduler is None:
            return "the bus is being brought up", NEXT[State.OFF]
        if daemon.recovering:
            return "a reset is bringing devices back", "wait for it, or estop"
        if TRANSITIONS[state, Event(operator)] is state:
            return f"{operator.name.lower()} is not allowed in {state.name}", NEXT[state]
        if operator is Operator.ARM:
            tick = int(daemon.cycle.record.timing.tick)
            found = "; ".join(daemon.self_test.obstacles(tick))
            return (
                (f"the self-test failed: {found}", "correct that, then arm") if found else ("", "")
            )
        return "", ""

    def _choose(self, state: State, name: object) -> tuple[str, str, int]:
        if self._console.script is not None:
            return *_SCRIPTED, 0
        if name not in self._names:
            said = (
                "name is missing" if name is None else f"there is no scenario {reprlib.repr(name)}"
            )
            return said, f"choose one of {', '.join(self._names)}", 0
        if not self._daemon.cycle.selectable:
            slowing = state is State.HOLD
            error = (
                "the scenario is still slowing down" if slowing else f"not while in {state.name}"
            )
            return (
                error,
                "repeat the command in a moment" if slowing else "hold or stop it first",
                0,
            )
        return "", "", self._names.index(str(name)) + 1

    def later(self) -> Reply | None:
        """The reply to the last command, once a tick has taken it."""
        awaited = self._awaited
        if awaited is None or self._console.pending:
            return None
        self._awaited = None
        return self._became(awaited)

    def _became(self, awaited: _Awaited) -> Reply:
        """What became of a command that a tick has taken."""
        verb, before = awaited.verb, awaited.before
        state = self._daemon.cycle.sequence.state
        if awaited.change.number:
            return self._tuned(awaited, state)
        if verb.operator is Operator.NONE:
            if self._chosen + 1 == awaited.select:
                return self._done(verb, state, f"{self._names[self._chosen]} is what START plays")
            return self._refusal(verb, state, "the robot began to move", "hold or stop it first")
        if self._console.refusal:
            return self._refusal(verb, state, self._console.refusal, "correct that, then arm")
        event = Event(verb.operator)
        wanted = TRANSITIONS[before, event]
        if state is wanted and (before, event) in MOVES:
            text = f"{before.name} to {state.name}: {MOVES[before, event].reason}"
            return self._done(verb, state, text)
        if state is wanted:
            return self._done(verb, state, f"it was in {state.name} already")
        if self._daemon.recovering:
            return self._done(verb, state, "devices are being brought back")
        return self._refusal(verb, state, self._fault or "it came too late", NEXT[state])

    def _tuned(self, awaited: _Awaited, state: State) -> Reply:
        tuning, change = self._daemon.cycle.tuning, awaited.change
        if not tuning.accepted(change):
            return self._refusal(awaited.verb, state, *tuning.against(change, state))
        index = change.number - 1
        text = (
            f"{tuning.keys[index]} goes from {tuning.before:g} to {change.value:g} "
            f"in {tuning.left(index):.1f} s"
        )
        return self._done(awaited.verb, state, text)

    def watch(self) -> None:
        """Once a tick: a scenario that has been played ends in HOLD."""
        playing = self._daemon.cycle.sequence.state is State.ACTIVE
        if playing and self._finished and self._console.script is None:
            self._console.give(Operator.HOLD, "the end of the scenario")

    @property
    def _chosen(self) -> int:
        return int(self._daemon.cycle.record.state.scenario)

    @property
    def _finished(self) -> bool:
        played = float(self._daemon.cycle.record.state.scenario_time)
        return played >= self._catalogue[self._chosen].duration

    @property
    def _fault(self) -> str | None:
        sequence = self._daemon.cycle.sequence
        if sequence.fault is Fault.NONE:
            return None
        return describe(self._config, sequence.fault, sequence.where, sequence.reason)

    def _status(self) -> Reply:
        daemon, config = self._daemon, self._config
        sequence, record = daemon.cycle.sequence, daemon.cycle.record
        state = sequence.state
        bringing_up = daemon.scheduler is None
        return {
            "ok": True,
            "op": "status",
            "config": config.name,
            "controller": config.control.controller,
            "served": self._console.script is None,
            "state": state.name,
            "meaning": MEANING[state],
            "next": NEXT[state],
            "armed": state in ARMED,
            "recovering": daemon.recovering,
            "elapsed_s": round(sequence.elapsed, 3),
            "tick": None if bringing_up else int(record.timing.tick),
            "fault": self._fault,
            "scenario": self._names[self._chosen],
            "scenario_s": round(float(record.state.scenario_time), 3),
            "duration_s": self._catalogue[self._chosen].duration,
            "scenarios": self._names,
            "self_test": [
                {"item": found.item, "ok": found.ok, "text": found.text}
                for found in daemon.self_test.findings
            ],
            "tunable": [
                {
                    **each.model_dump(),
                    "value": round(daemon.cycle.tuning.value(index), 6),
                    "target": daemon.cycle.tuning.targets[index],
                }
                for index, each in enumerate(config.operation.tunable)
            ],
            "k_eq_n_per_m": round(float(record.stiffness.k_eq), 1),
            "tension_n": [round(float(tension), 1) for tension in record.tension.measured],
            "contact_n": round(float(daemon.cycle.forces[-1]), 2),
            "position_m": [round(float(each), 5) for each in record.pose.position],
            "grade": Grade(int(record.envelope.grade)).name,
            "missed_own": 0 if daemon.scheduler is None else daemon.scheduler.misses.own,
            "missed_host": 0 if daemon.scheduler is None else daemon.scheduler.misses.host,
            "wakeup_us": round(float(record.timing.wakeup_us), 1),
            "log": self._log,
        }

    def _done(self, verb: Verb, state: State, text: str) -> Reply:
        return {"ok": True, "op": verb.name, "state": state.name, "text": text, "next": NEXT[state]}

    def _refusal(self, verb: Verb, state: State, error: str, remedy: str) -> Reply:
        return {**refusal(error, remedy), "op": verb.name, "state": state.name}


def refusal(error: str, remedy: str) -> Reply:
    """The reply to what is not done."""
    return {"ok": False, "error": " ".join(error.split())[:_LINE], "next": remedy}
