"""A table once, shown three ways: on the terminal, as CSV, as HTML."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table as Printed
from rich.text import Text

from tonus.tools.pages.page import page
from tonus.tools.pages.rows import NUMBER, Row, Rows

_GAP = 3
"""characters between columns of a terminal's table"""
_LABEL = 26
"""characters at which a text in the first columns may be wrapped"""


@dataclass(frozen=True)
class Spread:
    """A figure over repetitions."""

    mean: float
    sd: float | None
    """sample standard deviation; None of a single one"""
    low: float
    high: float
    count: int

    @classmethod
    def of(cls, values: Iterable[float] | NDArray[np.float64]) -> Spread | None:
        """None without any value."""
        found = np.array(list(values), dtype=np.float64)
        if not len(found):
            return None
        sd = float(found.std(ddof=1)) if len(found) > 1 else None
        return cls(float(found.mean()), sd, float(found.min()), float(found.max()), len(found))

    def times(self, factor: float) -> Spread:
        """In another unit; ``factor`` positive."""
        sd = None if self.sd is None else self.sd * factor
        return Spread(self.mean * factor, sd, self.low * factor, self.high * factor, self.count)

    @property
    def sd_percent(self) -> float | None:
        """Of the mean; None without a deviation or about zero."""
        if self.sd is None or self.mean == 0.0:
            return None
        return 100.0 * self.sd / abs(self.mean)

    def as_json(self) -> dict[str, float | int | None]:
        return {
            "mean": self.mean,
            "sd": self.sd,
            "min": self.low,
            "max": self.high,
            "n": self.count,
        }


Cell = str | float | int | Spread | None


@dataclass(frozen=True)
class Column:
    """``digits``: significant digits of its numbers; 0: as they are."""

    name: str
    unit: str = ""
    digits: int = 3

    @property
    def heading(self) -> str:
        return f"{self.name} / {self.unit}" if self.unit else self.name


@dataclass
class Table:
    """Rows of cells; a Spread is printed as mean ± deviation."""

    name: str
    """of its files"""
    title: str
    columns: tuple[Column, ...]
    rows: list[list[Cell]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    marked: set[tuple[int, int]] = field(default_factory=set)
    """cells (row, column) that stand out"""
    lead: int = 1
    """columns that say what a row is"""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Side by side as far as the terminal is wide, the rest below, the first columns again."""
        parts = self._parts(options.max_width)
        for number, places in enumerate(parts):
            yield self._printed(places, number == 0, number == len(parts) - 1)

    def _parts(self, width: int) -> list[list[int]]:
        """Columns by place, in stretches that fit into ``width`` characters."""
        lead = list(range(self.lead))
        used = start = sum(self._width(place) + _GAP for place in lead)
        parts: list[list[int]] = [[]]
        for place in range(self.lead, len(self.columns)):
            own = self._width(place) + _GAP
            if parts[-1] and used + own > width:
                parts.append([])
                used = start
            parts[-1].append(place)
            used += own
        return [lead + part for part in parts]

    def _width(self, place: int) -> int:
        column = self.columns[place]
        cells = [len(text(row[place], column.digits)) for row in self.rows]
        widest = max([*cells, *(len(word) for word in column.heading.split())])
        return min(widest, _LABEL) if place < self.lead else widest

    def _printed(self, places: list[int], first: bool, last: bool) -> Printed:
        table = Printed(
            title=self.title if first else None,
            title_justify="left",
            title_style="bold",
            box=box.SIMPLE_HEAD,
            caption="\n".join(self.notes) if last and self.notes else None,
            caption_justify="left",
            pad_edge=False,
        )
        for place in places:
            right = self._numeric(place)
            table.add_column(
                self.columns[place].heading,
                justify="right" if right else "left",
                no_wrap=place >= self.lead,
            )
        for row, cells in enumerate(self.rows):
            table.add_row(
                *(
                    Text(
                        text(cells[place], self.columns[place].digits),
                        style="bold" if (row, place) in self.marked else "",
                    )
                    for place in places
                )
            )
        return table

    def csv(self) -> str:
        """A Spread becomes three columns: mean, standard deviation, count."""
        spread = [
            any(isinstance(row[place], Spread) for row in self.rows)
            for place in range(len(self.columns))
        ]
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        heading: list[str] = []
        for column, wide in zip(self.columns, spread, strict=True):
            heading += [column.heading]
            if wide:
                heading += [f"{column.heading}, SD", f"{column.name}, n"]
        writer.writerow(heading)
        for row in self.rows:
            line: list[object] = []
            for cell, wide in zip(row, spread, strict=True):
                if isinstance(cell, Spread):
                    line += [_exact(cell.mean), _exact(cell.sd), cell.count]
                else:
                    line += [_exact(cell), *(["", ""] if wide else [])]
            writer.writerow(line)
        return buffer.getvalue()

    def shown(self) -> Rows:
        """As a page shows it."""
        heads = [(column.heading, self._numeric(n)) for n, column in enumerate(self.columns)]
        shown = Rows(heads, notes=self.notes, title=self.title)
        for row, cells in enumerate(self.rows):
            styled = []
            for place, cell in enumerate(cells):
                kinds = [NUMBER] if self._numeric(place) else []
                kinds += ["best"] if (row, place) in self.marked else []
                styled.append((text(cell, self.columns[place].digits), " ".join(kinds)))
            shown.lines.append(Row(styled))
        return shown

    def html(self) -> str:
        """As a page of its own."""
        return page("table.html.j2", self.title, subtitle="", shown=replace(self.shown(), title=""))

    def _numeric(self, place: int) -> bool:
        return not any(isinstance(row[place], str) for row in self.rows)


def text(cell: Cell, digits: int = 3) -> str:
    """As a person reads it: mean and deviation to the same place, a digit more than asked where the
    deviation would else vanish."""
    if cell is None:
        return "–"
    if isinstance(cell, str):
        return cell
    if isinstance(cell, Spread):
        if cell.sd is None:
            return number(cell.mean, digits)
        places = _places(cell.mean or cell.sd, digits)
        if cell.sd > 0.0:
            finer = min(_places(cell.sd, 1), _places(cell.mean, digits + 1))
            places = max(places, finer) if cell.mean else places
        return f"{_plain(cell.mean, places)} ± {_plain(cell.sd, places)}"
    return str(cell) if isinstance(cell, int) else number(cell, digits)


def number(value: float, digits: int = 3) -> str:
    """Significant digits, without an exponent; 0 digits: as the number is."""
    if digits == 0:
        return f"{value:g}"
    return _plain(value, _places(value, digits))


def _places(value: float, digits: int) -> int:
    if value == 0.0:
        return 0
    return max(digits - 1 - math.floor(math.log10(abs(value))), 0)


def _plain(value: float, places: int) -> str:
    shown = f"{value:.{min(places, 9)}f}"
    return shown.lstrip("-") if float(shown) == 0.0 else shown


def _exact(cell: Cell) -> object:
    return "" if cell is None else cell
