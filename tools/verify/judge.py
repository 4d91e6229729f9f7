"""A scenario's expectations, asked of the log of its run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf

from tonus.config.schema.expectation import (
    Allowed,
    Ends,
    Expectation,
    Figure,
    Happens,
    Invariants,
    Never,
    Rms,
    Settles,
    Stays,
)
from tonus.tools.errors import ToolError
from tonus.tools.expect import ExpectationError, Run, Signal


@dataclass(frozen=True)
class Verdict:
    """One expectation: what was expected, and why it was not met (empty: it was)."""

    expected: str
    problem: str


def judge(run: Run, expectations: Sequence[Expectation]) -> list[Verdict]:
    """Each expectation's verdict, and last that of warnings and errors that none of them names.
    One that the log cannot answer is not met."""
    found = [_one(run, each) for each in expectations]
    return [*found, _asked("no other warning or error", run.undisturbed)]


def _one(run: Run, each: Expectation) -> Verdict:
    return _asked(_told(each), lambda: _ask(run, each))


def _asked(expected: str, ask: Callable[[], None]) -> Verdict:
    try:
        ask()
    except ExpectationError as error:
        return Verdict(expected, error.figure)
    except ToolError as error:
        return Verdict(expected, str(error))
    return Verdict(expected, "")


def _ask(run: Run, each: Expectation) -> None:
    """Raises `ExpectationError`."""
    if isinstance(each, Happens):
        run.expect(each.event, where=each.where, within=each.within, after=each.after)
    elif isinstance(each, Never):
        run.never(each.event, where=each.where)
    elif isinstance(each, Allowed):
        run.allow(each.event)
    elif isinstance(each, Ends):
        if run.state != each.state:
            raise run.failure(f"it ends in {run.state}: {run.reason}")
    elif isinstance(each, Stays):
        _signal(run, each).stays(each.low, each.high)
    elif isinstance(each, Settles):
        _signal(run, each).settles(each.value, band=each.band, within=each.within)
    elif isinstance(each, Rms):
        _signal(run, each).rms(about=each.about, at_most=each.at_most)
    elif isinstance(each, Figure):
        _figure(run, each)
    elif isinstance(each, Invariants):
        run.invariants()
    else:
        run.replays()


def _signal(run: Run, each: Stays | Settles | Rms) -> Signal:
    signal = run.signal(each.topic, each.field)
    if each.norm:
        signal = signal.norm()
    if each.index is not None:
        signal = signal[each.index]
    if each.during:
        signal = signal.during(*each.during)
    if each.start or each.end is not None:
        signal = signal.between(each.start, inf if each.end is None else each.end)
    return signal


def _figure(run: Run, each: Figure) -> None:
    value: object = run.summary
    for part in each.key.split("."):
        if not isinstance(value, dict) or part not in value:
            raise ToolError(f"summary.json has no {each.key}; docs/operation.md lists its keys")
        value = value[part]
    if not isinstance(value, int | float) or not value <= each.at_most:
        raise run.failure(f"{each.key} is {value}, and at most {each.at_most:g} is allowed")


def _told(each: Expectation) -> str:
    """An expectation in one line: its kind and what its keys say."""
    keys = each.model_dump(exclude_defaults=True, exclude={"kind"})
    shown = (f"{key} {_plain(value)}" for key, value in keys.items())
    return " ".join([each.kind, *shown])


def _plain(value: object) -> str:
    return "/".join(map(str, value)) if isinstance(value, tuple) else str(value)
