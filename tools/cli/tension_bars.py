"""Tensions as bars, for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table
from rich.text import Text

_SCALES = (25.0, 50.0, 100.0, 200.0, 400.0, 800.0)
"""N, of a whole bar: the smallest that holds every cable, so that bars do not jump"""
_EIGHTHS = " ▏▎▍▌▋▊▉█"


def bars(tensions: Sequence[float], width: int) -> Table:
    """A line for each cable: its number, its bar of at most ``width`` characters, N."""
    most = max((abs(each) for each in tensions), default=0.0)
    full = next((scale for scale in _SCALES if most <= scale), most)
    table = Table(show_header=True, box=None, pad_edge=False, header_style="dim")
    table.add_column("cable", justify="right", style="dim")
    table.add_column(f"tension, {full:.0f} N for a whole bar", width=width)
    table.add_column("N", justify="right")
    for number, tension in enumerate(tensions):
        share = min(max(tension / full, 0.0), 1.0)
        table.add_row(str(number), Text(bar(share, width), style="cyan"), f"{tension:.1f}")
    return table


def bar(share: float, width: int) -> str:
    """Filled to a share of its width, in eighths of a character."""
    eighths = round(share * width * 8)
    whole, rest = divmod(eighths, 8)
    return "█" * whole + (_EIGHTHS[rest] if rest else "")
