"""Claims about the tension loop, the limits and stability."""

from __future__ import annotations

from collections.abc import Iterator

from tonus.tools.paper import printed
from tonus.tools.paper.case import Kind
from tonus.tools.paper.claims.wording import LOADS, Text, claim_of, over_trials
from tonus.tools.paper.compare import BIO, LITERAL, usual
from tonus.tools.paper.results import Results
from tonus.tools.paper.table import Spread, number
from tonus.tools.paper.verdicts import Claim, Judgement, Verdict, limit

_OPEN_PEAK = 35.0
"""N that a contact must exceed with the envelope off, or it proves nothing about the envelope"""


def inner_loop(results: Results) -> Iterator[Claim]:
    """How well tensions are kept, and whether eq. (9) as printed could."""
    hold = over_trials(results, "tension_percent", Kind.HOLD)
    yield claim_of(
        ("tension", "Tension is kept in hold", "error below 0.5 % (3.1)"),
        0.5,
        "%",
        hold,
        limit(hold, 0.5),
        Text("RMS of true tension less reference, in % of the reference, over all cables."),
    )
    motion = over_trials(results, "tension_percent_max", Kind.SINE)
    yield claim_of(
        ("tension_motion", "Largest tension deviation", "below 2 % (3.2, there “voltage”)"),
        2.0,
        "%",
        motion,
        limit(motion, 2.0),
        Text("Largest of any cable in any tick of the sines.", "Friction reverses with motion."),
    )
    literal = results.select(controller=LITERAL, plant=None, bus=None)
    broken = [row for row in literal if row.fault]
    ours = Spread.of(literal.values("tension_percent"))
    judged = limit(ours, 0.5)
    if broken:
        judged = Judgement(
            Verdict.NOT_REPRODUCED, f"{judged.rule}; a trial that ends in a fault is not"
        )
    yield claim_of(
        ("eq9", "The tension loop of eq. (9) as printed works", "error below 0.5 % (eq. 9)"),
        0.5,
        "%",
        ours,
        judged,
        Text(
            f"{len(broken)} of {len(literal.rows)} trials ended in a fault."
            if literal.rows
            else "",
            "Proportional alone needs a gain of 199 for 0.5 %, and two ticks of delay make that "
            "oscillate; ours adds feed-forward, integral and drum damping.",
        ),
    )


def safety(results: Results) -> Iterator[Claim]:
    """Contact force and the envelope."""
    peak = over_trials(results, "contact_peak", Kind.CONTACT)
    contact = results.select(kind=Kind.CONTACT, plant=None, bus=None)
    unlimited = Spread.of(
        Results([row for row in contact if not row.indicators.get("envelope_enabled", 1.0)]).values(
            "contact_peak"
        )
    )
    judged = limit(peak, printed.CONTACT_LIMIT)
    if unlimited is None or unlimited.low <= _OPEN_PEAK:
        judged = judged.at_most(
            Verdict.CONSISTENT,
            f"with the envelope off the contact was not seen to exceed {_OPEN_PEAK:g} N",
        )
    without = "" if unlimited is None else f"With the envelope off: {number(unlimited.high)} N."
    yield claim_of(
        ("contact", "Largest contact force", "below 25 N (abstract)"),
        printed.CONTACT_LIMIT,
        "N",
        peak,
        judged,
        Text(without),
    )
    rows = usual(results).select(controller=BIO)
    ticks = Spread.of(rows.values("violation_ticks"))
    amber = Spread.of(rows.values("amber_percent"))
    warned = (
        ""
        if amber is None
        else f" The envelope acted (amber) in {number(amber.mean, 2)} % of ticks."
    )
    yield claim_of(
        (
            "envelope",
            "Always in the green region: no limit exceeded, no contact lost",
            "permanently (section 4)",
        ),
        0.0,
        "ticks",
        ticks,
        limit(ticks, 0.0),
        Text(
            "True tension over T_max or slack, contact over 25 N, speed, workspace or K_eq out of "
            f"bounds, per trial.{warned}"
        ),
    )


def stability(results: Results) -> Iterator[Claim]:
    """Eq. (13), and whether anything went wrong."""
    broken = over_trials(results, "eq13_broken_percent", (*LOADS, Kind.SINE))
    yield claim_of(
        ("eq13", "V' ≤ −C ė² with the adaptive law", "eq. (13)"),
        0.0,
        "% of ticks",
        broken,
        limit(broken, 0.0),
        Text(
            "Ticks in which ½ K̇ e², which (13) leaves out, exceeds what the damper takes, so that "
            "V would grow by itself.",
            "What keeps it bounded here is the rate bound and the energy tank.",
        ),
    )
    rows = [row for row in usual(results).select(plant=None, bus=None) if row.controller == BIO]
    share = Spread.of([0.0 if row.completed else 100.0 for row in rows])
    drawn = sum(row.drawn for row in rows)
    bad = sum(not row.completed for row in rows)
    yield claim_of(
        ("stable", "No instability in any scenario", "none (3.4, 4)"),
        0.0,
        "% of trials",
        share,
        limit(share, 0.0),
        Text(f"{bad} of {len(rows)} trials ended in a fault, {drawn} of them on drawn plants."),
    )
