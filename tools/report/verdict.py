"""What a run came to: how it ended, and its key figures held against the limits it ran under."""

from __future__ import annotations

from dataclasses import dataclass, replace

from tonus.runtime.states import State
from tonus.tools.report.story import Story
from tonus.tools.run.summary import Indicators, Summary, summarise

_ENDED_WELL = (State.OFF, State.STANDBY)
_ACTIVE, _REGULATED = "ACTIVE", "HOLD and ACTIVE"
"""windows of the figures that `Indicators` does not take over the whole run"""


@dataclass(frozen=True)
class Figure:
    """One key figure; ``ok`` is None where there is no limit to hold it against."""

    name: str
    value: float | None
    unit: str
    limit: str = ""
    ok: bool | None = None
    against: str = ""
    """what it was computed from"""
    window: str = "the whole run"
    """when"""


@dataclass(frozen=True)
class Verdict:
    """The head of a report."""

    headline: str
    good: bool
    remarks: tuple[str, ...]
    figures: tuple[Figure, ...]
    summary: Summary
    damaged: bool = False
    """the log is"""


def judge(story: Story, indicators: Indicators) -> Verdict:
    """A run is good that ended in STANDBY or OFF without a fault and whose log is whole."""
    log = story.log
    summary = summarise(log, indicators=indicators)
    figures = tuple(_figures(story, summary, indicators.speed))
    remarks = []
    if log.damage:
        remarks.append(f"The log is damaged: {log.damage}. All below is of what could be read.")
    remarks += [
        f"{name}: {count} records were lost before they were recorded."
        for name, count in log.recorded.items()
        if int(count)
    ]
    if story.note:
        remarks.append(f"Without limits: {story.note}.")
    if not story.has_truth:
        remarks.append("No truth in this log: accuracy is that of the robot's own sensors.")
    over = [figure.name for figure in figures if figure.ok is False]
    if over:
        remarks.append(f"Outside its limit: {', '.join(over)}.")
    ended = State[summary["state"]]
    good = not summary["faults"] and ended in _ENDED_WELL and not log.damage
    headline = _headline(story, summary, ended)
    damaged = log.damage is not None
    return Verdict(headline, good, tuple(remarks), figures, summary, damaged)


def _headline(story: Story, summary: Summary, ended: State) -> str:
    if summary["faults"]:
        first = summary["faults"][0]
        where = f" at {first['where']}" if first["where"] else ""
        at = f"{story.at(first['tick']):.3f} s"
        return f"Fault {first['name']}{where} after {at}; ended in {ended.name}"
    if story.log.damage:
        return f"No fault up to the damage; last seen in {ended.name}"
    if ended in _ENDED_WELL:
        return f"Completed without a fault; ended in {ended.name}"
    return f"No fault; the log ends in {ended.name}"


def _figures(story: Story, summary: Summary, speed: float) -> list[Figure]:
    source = "truth" if story.has_truth else "measured"
    tension, k_eq = summary["tension_n"], summary["k_eq_n_per_m"]
    tracking, held = _mm(summary["tracking_rmse_m"]), summary["tension_rmse_n"]
    low, high = _ends(tension)
    k_low, k_high = _ends(k_eq)
    peak = summary["contact_peak_n"]
    found = [
        Figure("tracking error, RMS", tracking, "mm", against="truth", window=_ACTIVE),
        Figure("tension error, RMS", held, "N", against="truth", window=_REGULATED),
        Figure("tension, lowest", low, "N", against=source, window=_REGULATED),
        Figure("tension, highest", high, "N", against=source, window=_REGULATED),
        Figure("K_eq, lowest", k_low, "N/m", against="commanded", window=_REGULATED),
        Figure("K_eq, highest", k_high, "N/m", against="commanded", window=_REGULATED),
        Figure("contact force, highest", peak, "N", against=source),
        Figure("speed, highest", speed, "m/s", against="estimate"),
    ]
    if story.config is not None:
        control = story.config.control
        bounds, law, envelope = control.tension, control.stiffness, control.envelope
        limited = [
            *(_least(found[2], bounds.min), _most(found[3], bounds.max)),
            *(_least(found[4], law.minimum), _most(found[5], law.maximum)),
            *(_most(found[6], envelope.contact_limit), _most(found[7], envelope.speed_limit)),
        ]
        found = [*found[:2], *limited]
    return [*found, *_timing(story, summary)]


def _timing(story: Story, summary: Summary) -> list[Figure]:
    missed = Figure(
        "ticks missed, our own", summary["missed_ticks"], "", "0", summary["missed_ticks"] == 0
    )
    found = [missed, Figure("ticks missed, by the host", summary["missed_by_host"], "")]
    if story.log.metadata.get("time") == "virtual":
        return found
    period, cycle = story.period * 1e6, summary["cycle_us"]["p99_9"]
    return [
        *found,
        Figure("wake-up, p99.9", summary["wakeup_us"]["p99_9"], "µs"),
        _most(Figure("cycle, p99.9", cycle, "µs", against="wall clock"), period),
    ]


def _least(figure: Figure, bound: float) -> Figure:
    ok = None if figure.value is None else figure.value >= bound
    return replace(figure, limit=f"at least {bound:g}", ok=ok)


def _most(figure: Figure, bound: float) -> Figure:
    ok = None if figure.value is None else figure.value <= bound * (1.0 + 1e-12)
    return replace(figure, limit=f"at most {bound:g}", ok=ok)


def _ends(span: dict[str, float] | None) -> tuple[float | None, float | None]:
    return (None, None) if span is None else (span["min"], span["max"])


def _mm(metres: float | None) -> float | None:
    return None if metres is None else metres * 1e3
