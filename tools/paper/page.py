"""paper.html: one page that tells a campaign, verdicts first, and needs nothing but itself."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from html import escape

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
_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;max-width:1180px;margin:1.5rem auto;padding:0 1rem;
color:#111}
h1{font-size:1.35rem;margin:0 0 .3rem}h2{font-size:1.15rem;margin:2.2rem 0 .5rem}
h3{font-size:1rem;margin:1.6rem 0 .3rem}
nav{margin:.8rem 0}nav a{margin-right:1rem}
.sum{display:flex;gap:.6rem;flex-wrap:wrap;margin:1rem 0}
.sum div{padding:.5rem .9rem;border-left-width:.4rem;border-left-style:solid;min-width:7.5rem}
.sum b{font-size:1.5rem;display:block}
.good{border-color:#0072B2;background:#E8F1F8}.fair{border-color:#E69F00;background:#FCF3E0}
.bad{border-color:#D55E00;background:#FBEBE0}.none{border-color:#999;background:#F4F4F4}
.wide{overflow-x:auto}
table{border-collapse:collapse;margin:.3rem 0}td,th{padding:.2rem .8rem .2rem 0;text-align:left;
border-bottom:1px solid #ddd;vertical-align:top}
th.n,td.n{text-align:right}td.n{font-variant-numeric:tabular-nums;white-space:nowrap}
td.best{font-weight:700}
td.ours{white-space:nowrap}
table.claims td{padding:.35rem .8rem .35rem .4rem}
td.verdict{border-left-width:.4rem;border-left-style:solid;font-weight:600;white-space:nowrap}
.note,.rule{color:#555;font-size:.86rem;margin:.15rem 0}
figure{margin:.6rem 0 1.8rem}figcaption{color:#333}img{width:100%;height:auto}
img.part{max-width:860px}summary{cursor:pointer}
"""


def page(
    results: Results,
    claims: Sequence[Claim],
    tables: Sequence[Table],
    pictures: Sequence[tuple[str, str, str, bytes, bool]],
) -> str:
    """``pictures``: name, heading, caption, SVG, and whether it is a wide one. The first of
    ``tables`` stand beside the verdicts, the rest by stage."""
    return "".join(_parts(results, claims, tables, pictures))


def _parts(
    results: Results,
    claims: Sequence[Claim],
    tables: Sequence[Table],
    pictures: Sequence[tuple[str, str, str, bytes, bool]],
) -> Iterator[str]:
    title = "The paper's protocol, its tables and its claims"
    yield (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>\n"
        f"<h1>{escape(title)}</h1><div>{escape(_subtitle(results))}</div>\n"
    )
    yield (
        '<nav><a href="#verdicts">Verdicts</a><a href="#tables">Tables</a>'
        '<a href="#figures">Figures</a><a href="#failed">Failed trials</a></nav>\n'
    )
    yield '<h2 id="verdicts">Verdicts</h2>\n' + _counts(claims) + _claims(claims)
    yield '<h2 id="tables">Tables</h2>\n' + "".join(table.html() for table in tables if table.rows)
    yield '<h2 id="figures">Figures</h2>\n'
    if not pictures:
        yield "<p>No curves were kept.</p>\n"
    for name, heading, caption, svg, wide in pictures:
        data = base64.b64encode(svg).decode()
        kind = "" if wide else ' class="part"'
        yield (
            f'<h3 id="{name}">{escape(heading)}</h3><figure>'
            f'<img{kind} alt="{escape(heading)}" src="data:image/svg+xml;base64,{data}">'
            f"<figcaption>{escape(caption)}</figcaption></figure>\n"
        )
    yield _failed(results)
    yield "</body></html>\n"


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


def _counts(claims: Sequence[Claim]) -> str:
    boxes = []
    for verdict in Verdict:
        count = sum(claim.verdict is verdict for claim in claims)
        boxes.append(f'<div class="{_COLOURS[verdict]}"><b>{count}</b>{verdict}</div>')
    return '<div class="sum">' + "".join(boxes) + "</div>\n"


def _claims(claims: Sequence[Claim]) -> str:
    lines = []
    for claim in claims:
        style = _COLOURS[claim.verdict]
        ours = "–" if claim.ours is None else f"{text(claim.ours)} {claim.unit}"
        lines.append(
            f'<tr><td class="verdict {style}">{_SIGNS[claim.verdict]} {claim.verdict}</td>'
            f"<td>{escape(claim.claim)}</td><td>{escape(claim.paper)}</td>"
            f"<td class=ours>{escape(ours)}</td><td>{escape(claim.sentence)}"
            f'<details class="rule"><summary>rule</summary>{escape(claim.rule)}</details></td></tr>'
        )
    return (
        '<div class=wide><table class="claims"><tr><th>verdict</th><th>claim</th><th>paper</th>'
        "<th>ours, mean ± SD</th><th></th></tr>\n" + "\n".join(lines) + "</table></div>\n"
    )


def _failed(results: Results) -> str:
    rows = [row for row in results if not row.completed]
    head = f'<h2 id="failed">Failed trials</h2>\n<p>{len(rows)} of {len(results.rows)}</p>\n'
    if not rows:
        return head
    lines = "".join(
        f"<tr><td>{escape(row.key)}</td><td>{escape(row.state)}</td>"
        f"<td>{escape(row.fault)}</td><td>{escape(row.reason)}</td></tr>\n"
        for row in rows
    )
    return (
        head + "<table><tr><th>trial</th><th>state</th><th>fault</th><th>reason</th></tr>\n"
        f"{lines}</table>\n"
    )
