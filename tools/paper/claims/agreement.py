"""Claims about model against experiment, repeatability, and superiority over PID."""

from __future__ import annotations

from collections.abc import Iterator

from tonus.tools.paper import printed
from tonus.tools.paper.case import Kind
from tonus.tools.paper.claims.wording import LOADS, Text, claim_of, over_trials
from tonus.tools.paper.compare import BIO, REFERENCE, VARIANTS, Compared, Match, compared, of
from tonus.tools.paper.printed import Indicator
from tonus.tools.paper.results import Results
from tonus.tools.paper.table import Spread, number
from tonus.tools.paper.verdicts import Claim, Judgement, Verdict, gain, limit

_WHY = {
    "settling": "All follow one minimum-jerk reference with the same feed-forward. ",
    "overshoot_percent": "All follow one minimum-jerk reference with the same feed-forward. ",
    "energy_per_period": "Free motion and pretension ask the same work of every controller. ",
    "efficiency_percent": "Free motion and pretension ask the same work of every controller. ",
    "stiffness_deviation_percent": "Co-contraction adds geometric stiffness as K_eq rises. ",
}
"""What explains that there is no gain"""


def agreement(results: Results, matches: list[Match]) -> Iterator[Claim]:
    """Lab against model, and repetition against repetition."""
    ours = Spread.of([found.r2 for found in matches])
    said = ""
    if matches:
        worst = min(matches, key=lambda found: found.r2).case
        slack = min(matches, key=lambda found: found.force_r2)
        said = (
            "Lab against model, of what a case excites: the contact force, or the position; least: "
            f"{worst}. Of the cables' resultant alone, which slow motion hardly moves: at least "
            f"{number(slack.force_r2)} ({slack.case})."
        )
    yield claim_of(
        ("r2", "R² of model and experiment", "above 0.95 in every scenario (3.4)"),
        0.95,
        "",
        ours,
        limit(ours, 0.95, least=True),
        Text(said),
    )
    off = Spread.of([found.force_percent for found in matches])
    yield claim_of(
        ("model_force", "Model and experiment differ in force", "by less than 5 % (3.3)"),
        5.0,
        "%",
        off,
        limit(off, 5.0),
        Text("RMS of the difference of the cables' resultant in % of its RMS, case by case."),
    )
    spreads = {}
    for indicator in (printed.FORCE, printed.SETTLING):
        spread = compared(results, indicator).spread(BIO)
        if spread is not None and spread.sd_percent is not None:
            spreads[indicator.symbol] = spread.sd_percent
    ours = Spread.of(spreads.values())
    shown = ", ".join(f"{name} {number(value, 2)} %" for name, value in spreads.items())
    yield claim_of(
        ("repeatability", "SD of RMS force error and settling time", "below 5 % (3.4)"),
        5.0,
        "%",
        ours,
        limit(ours, 5.0),
        Text(
            f"{shown}. Seeds draw a new robot each, repetitions of the paper do not." * bool(shown)
        ),
    )


def superiority(results: Results) -> Iterator[Claim]:
    """Table 3's improvements, and what else the bio-inspired control is said to do better."""
    for indicator, pid, bio, margin in printed.TABLE3:
        yield _against_pid(results, indicator, margin, f"{pid:g} to {bio:g} (Table 3)")
    efficiency = compared(results, printed.EFFICIENCY).spread(BIO)
    drives = over_trials(results, "drive_efficiency_percent", Kind.SINE)
    alone = "" if drives is None else f" Each drive by itself: {number(drives.mean)} %."
    yield claim_of(
        ("efficiency_value", "Energy efficiency", "76.0 % (Tables 2 and 3)"),
        76.0,
        "%",
        efficiency,
        limit(efficiency, 76.0, least=True).at_most(
            Verdict.CONSISTENT, "the paper does not define it"
        ),
        Text(
            f"Positive power on the platform over positive electrical power, mean of sines.{alone}",
            "Holding eight tensions heats the windings all the time and moves nothing.",
        ),
    )
    lost = compared(results, printed.DISSIPATION).spread(BIO)
    yield claim_of(
        ("dissipation_value", "Dissipated energy", "30.5 J (Table 3)"),
        30.5,
        "J per period",
        lost,
        limit(lost, 30.5).at_most(Verdict.CONSISTENT, "the paper names no test for it"),
        Text("Friction, windings and cable damping, mean of the sines."),
    )
    peak = Indicator("Force peak", "F", "N", "force_peak", frozenset({Kind.STEP}))
    yield _against_pid(results, peak, 25.0, "over 25 % lower (section 4)", "transient force peaks")
    uniform = Indicator("Spread of tensions", "sd T", "N", "tension_spread", frozenset(LOADS))
    yield _against_pid(results, uniform, 0.0, "more uniform (section 4)", "tension distribution")


def _against_pid(
    results: Results, indicator: Indicator, margin: float, paper: str, what: str = ""
) -> Claim:
    found = compared(results, indicator)
    if indicator is printed.SETTLING and (claim := _only_one_settles(found, results, paper)):
        return claim
    ours = Spread.of(found.improvements(BIO))
    bio, pid = found.spread(BIO), found.spread(REFERENCE)
    said = ""
    if bio is not None and pid is not None:
        said = (
            f"{indicator.symbol}: {BIO} {number(bio.mean)}, "
            f"{'untuned' if results.untuned else 'tuned'} {REFERENCE} {number(pid.mean)} "
            f"{indicator.unit}."
        )
        if max(bio.mean, pid.mean) < indicator.floor:
            said += f" Both under {indicator.floor:g} {indicator.unit}, and so alike."
    others = {
        name: gains.mean
        for name in VARIANTS
        if (gains := Spread.of(found.improvements(name))) is not None and gains.low > 0.0
    }
    if others:
        name = max(others, key=lambda name: others[name])
        said += f" {name} is {number(others[name], 2)} % better than {REFERENCE} with every seed."
    elif bio is not None and found.best() == REFERENCE:
        said += f" {REFERENCE} is the best of all here."
    why = _WHY.get(indicator.key, "") if ours is not None and ours.low <= 0.0 else ""
    if ours is not None and ours.low > 0.0 and ours.mean < margin:
        said += f" Better, but not by {margin:g} %."
    label = what or indicator.label
    return claim_of(
        (
            f"better_{indicator.key}",
            f"Better than PID: {label}",
            f"{margin:g} %, {paper}" if margin else paper,
        ),
        margin,
        "%",
        ours,
        _as_tuned(results, gain(ours, margin)),
        Text(said, f"{why}The paper does not disclose how its PID was tuned; {_tuning(results)}"),
    )


def _as_tuned(results: Results, judgement: Judgement) -> Judgement:
    """Gains that were never tuned for a robot reproduce nothing about its controllers."""
    if not results.untuned:
        return judgement
    return judgement.at_most(Verdict.CONSISTENT, "the controllers are not tuned alike")


def _tuning(results: Results) -> str:
    if not results.untuned:
        return "here all were, with one budget."
    return (
        f"here they are NOT tuned alike ({results.untuned}), so that gains are compared as much as "
        "controllers; run tonus tune all --land first."
    )


def _only_one_settles(found: Compared, results: Results, paper: str) -> Claim | None:
    """A percentage of a time that never came cannot be had."""
    bio = found.spread(BIO)
    trials = of(results, found.indicator).select(controller=REFERENCE)
    if bio is None or not trials.rows or not all(r.get("unsettled") for r in trials):
        return None
    return claim_of(
        ("better_settling", f"Better than PID: {found.indicator.label}", paper),
        1.36,
        "s",
        bio,
        Judgement(Verdict.CONSISTENT, f"consistent: {BIO} settles and {REFERENCE} never does"),
        Text(
            f"{REFERENCE} is still on its way at the end in each of its {len(trials.rows)} trials, "
            "so that there is no percentage."
        ),
    )
