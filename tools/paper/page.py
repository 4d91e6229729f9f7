"""paper.html: one page that tells a campaign, verdicts first, and needs nothing but itself."""

from __future__ import annotations

from collections.abc import Sequence

from tonus.tools.pages.page import data_url, page
from tonus.tools.pages.rows import Rows
from tonus.tools.paper.results import Results
from tonus.tools.paper.table import Table, text
from tonus.tools.paper.verdicts import Claim, Verdict

_COLOURS = {
    Verdict.REPRODUCED: "good",
    Verdict.CONSISTENT: "fair",
    Verdict.NOT_REPRODUCED: "bad",
    Verdict.MISSING: "none",
}
_SIGNS = {
    Verdict.REPRODUCED: "✓",
    Verdict.CONSISTENT: "≈",
    Verdict.NOT_REPRODUCED: "✗",
    Verdict.MISSING: "–",
}


def paper_page(
    results: Results,
    claims: Sequence[Claim],
    tables: Sequence[Table],
    pictures: Sequence[tuple[str, str, str, bytes, bool]],
) -> str:
    """``pictures``: name, heading, caption, SVG, and whether it is a wide one. The first of
    ``tables`` stand beside the verdicts, the rest by stage."""
    return page(
        "paper.html.j2",
        "The paper's protocol, its tables and its claims",
        subtitle=_subtitle(results),
        counts=[
            (_COLOURS[verdict], sum(claim.verdict is verdict for claim in claims), verdict)
            for verdict in Verdict
        ],
        claims=[_claim(claim) for claim in claims],
        tables=[table.shown() for table in tables if table.rows],
        pictures=[
            {
                "name": name,
                "heading": heading,
                "caption": caption,
                "source": data_url(svg),
                "part": not wide,
            }
            for name, heading, caption, svg, wide in pictures
        ],
        trials=len(results.rows),
        failed=Rows.of(
            ("trial", "state", "fault", "reason"),
            ((row.key, row.state, row.fault, row.reason) for row in results if not row.completed),
        ),
    )


def _subtitle(results: Results) -> str:
    seeds = {row.seed for row in results.select()}
    drawn = len(results.select(plant="plants", bus=None).rows)
    can = len(results.select(bus="can", plant=None).rows)
    parts = [
        f"{len(results.rows)} trials",
        f"{len(results.select(plant=None, bus=None).names('controller'))} controllers",
        f"{len(seeds)} seeds in the lab",
    ]
    parts += [f"{drawn} drawn plants"] if drawn else []
    parts += [f"{can} trials on CAN frames"] if can else []
    parts += [f"controllers NOT tuned alike: {results.untuned}"] if results.untuned else []
    return ", ".join(parts)


def _claim(claim: Claim) -> dict[str, str]:
    return {
        "kind": _COLOURS[claim.verdict],
        "sign": _SIGNS[claim.verdict],
        "verdict": str(claim.verdict),
        "claim": claim.claim,
        "paper": claim.paper,
        "ours": "–" if claim.ours is None else f"{text(claim.ours)} {claim.unit}",
        "sentence": claim.sentence,
        "rule": claim.rule,
    }
