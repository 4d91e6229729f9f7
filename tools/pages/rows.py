"""A table as a page shows it: texts, and the style of each."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

NUMBER = "n"
"""style of a cell that holds a number"""


@dataclass(frozen=True)
class Row:
    cells: list[tuple[str, str]]
    """text and styles"""
    kind: str = ""
    """style of the whole row"""


@dataclass
class Rows:
    """``heads``: heading, and whether its column holds numbers; none: a table without headings."""

    heads: list[tuple[str, bool]]
    lines: list[Row] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    title: str = ""

    @classmethod
    def of(
        cls,
        heads: Iterable[str],
        rows: Iterable[Iterable[str]],
        numbers: Collection[int] = (),
    ) -> Rows:
        """Plain texts; ``numbers``: the columns that hold numbers."""
        shown = cls([(head, place in numbers) for place, head in enumerate(heads)])
        for row in rows:
            cells = [(text, NUMBER if place in numbers else "") for place, text in enumerate(row)]
            shown.lines.append(Row(cells))
        return shown
