"""What a campaign leaves behind: tables on the terminal, CSV, figures, one page and paper.json."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from rich.console import RenderableType
from rich.table import Table as Printed
from rich.text import Text

from tonus.tools.errors import ToolError
from tonus.tools.paper import tables
from tonus.tools.paper.claims import claims
from tonus.tools.paper.compare import matches
from tonus.tools.paper.figures import PICTURES
from tonus.tools.paper.look import WIDE
from tonus.tools.paper.page import paper_page
from tonus.tools.paper.results import Results
from tonus.tools.paper.table import Column, Table, text
from tonus.tools.paper.targets import targets
from tonus.tools.paper.verdicts import Claim, Verdict

Say = Callable[[RenderableType], None]
_STYLES = {
    Verdict.REPRODUCED: "green",
    Verdict.CONSISTENT: "yellow",
    Verdict.NOT_REPRODUCED: "red",
    Verdict.MISSING: "dim",
}
_PNG_DPI = 110
_TERMINAL_ROWS = 30
"""a longer table is for the page and the CSV only"""


def _silent(shown: RenderableType) -> None:
    pass


def publish(results: Results, out: Path, say: Say = _silent) -> dict[str, Any]:
    """Write tables/*.csv, figures/*.svg and *.png, paper.html and paper.json under ``out``, and
    return what is in paper.json. ``say`` receives the tables for a terminal (rich).

    Works on part of a campaign: what its trials do not bear on is left out, and a claim about it is
    "missing data". Raises ToolError where nothing can be written.
    """
    match = matches(results)
    judged = claims(results, match)
    second, second_json = tables.table2(results, match)
    third, third_json = tables.table3(results)
    drawn, drawn_json = tables.plants(results)
    framed, framed_json = tables.can_sample(results)
    aims, aims_json = targets(results)
    ordered = [
        *(third, tables.improvements(results), second, aims),
        *(tables.stage1(results), tables.stage2(results), tables.stage3(results), drawn, framed),
    ]
    ordered = [table for table in ordered if table.rows]
    whole: dict[str, Any] = {
        **{
            f"stage{stage}": tables.by_case(results.select(stage=stage, plant=None, bus=None))
            for stage in (1, 2, 3)
        },
        "table2": second_json,
        "table3": third_json,
        "claims": [claim.as_json() for claim in judged],
        "targets": aims_json,
        "plants": drawn_json,
        "can": framed_json,
        "not_tuned_alike": results.untuned or None,
    }
    whole = {key: _finite(entry) for key, entry in whole.items()}
    for table in ordered:
        if len(table.rows) <= _TERMINAL_ROWS:
            say(table)
    say(printed_claims(judged))
    if results.untuned:
        say(Text(f"NOT tuned alike: {results.untuned}; run tonus tune all --land first"))
    try:
        _write(results, out, judged, ordered, whole)
    except OSError as error:
        raise ToolError(f"{out}: {error.strerror}; choose another with --out") from error
    say(f"{out / 'paper.html'}: all of it, case by case and with figures; also as CSV and JSON")
    return whole


def _write(
    results: Results,
    out: Path,
    judged: Sequence[Claim],
    ordered: Sequence[Table],
    whole: dict[str, Any],
) -> None:
    (out / "tables").mkdir(parents=True, exist_ok=True)
    (out / "figures").mkdir(exist_ok=True)
    for table in [*ordered, claims_table(judged)]:
        (out / "tables" / f"{table.name}.csv").write_text(table.csv(), encoding="utf-8")
    pictures = []
    for picture in PICTURES:
        figure = picture.draw(results)
        if figure is None:
            continue
        svg = _drawn(figure)
        (out / "figures" / f"{picture.name}.svg").write_bytes(svg)
        figure.savefig(out / "figures" / f"{picture.name}.png", dpi=_PNG_DPI)
        wide = figure.get_figwidth() >= WIDE
        pictures.append((picture.name, picture.heading, picture.caption, svg, wide))
    text = paper_page(results, judged, ordered, pictures)
    (out / "paper.html").write_text(text, encoding="utf-8")
    body = json.dumps(whole, indent=1, ensure_ascii=False, allow_nan=False)
    (out / "paper.json").write_text(body + "\n", encoding="utf-8")


def claims_table(judged: Sequence[Claim]) -> Table:
    """The claims as plain cells."""
    head = ("name", "claim", "paper", "unit", "ours", "verdict", "sentence")
    return Table(
        "claims",
        "Claims of the paper",
        tuple(Column(name) for name in head),
        [
            [
                *(claim.name, claim.claim, claim.paper, claim.unit),
                *(claim.ours, str(claim.verdict), claim.sentence),
            ]
            for claim in judged
        ],
    )


def printed_claims(judged: Sequence[Claim]) -> Printed:
    """Verdicts for a terminal, and their count."""
    counts = ", ".join(
        f"{sum(claim.verdict is verdict for claim in judged)} {verdict}" for verdict in Verdict
    )
    shown = Printed(
        title=f"Claims of the paper: {counts}",
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
    )
    for name in ("verdict", "claim", "paper", "ours"):
        shown.add_column(name, justify="right" if name == "ours" else "left")
    for claim in judged:
        ours = "–" if claim.ours is None else f"{text(claim.ours)} {claim.unit}"
        verdict = Text(str(claim.verdict), style=_STYLES[claim.verdict])
        shown.add_row(verdict, Text(claim.claim), Text(claim.paper), Text(ours))
    return shown


def _drawn(figure: Figure) -> bytes:
    """SVG; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "tonus"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def _finite(value: Any) -> Any:
    """No nan and no infinity: JSON has neither. A figure that is none is null."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_finite(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
