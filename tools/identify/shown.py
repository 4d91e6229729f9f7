"""An identification on the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tonus.tools.identify.estimate import Estimate
from tonus.tools.identify.identify import Identification
from tonus.tools.identify.written import rounded

_COLOURS = {"as configured": "green", "uncertain": "yellow", "none found": "default", "": "default"}


def show(console: Console, found: Identification, *, truth: bool) -> None:
    """A table of all estimates, then how well the responses fit and what is missing."""
    table = Table("", title="Identified", title_justify="left")
    columns = ["value", "± 95 %", "unit", "configured", *(("true", "error") if truth else ())]
    for name in columns:
        table.add_column(name, justify="left" if name == "unit" else "right")
    table.add_column("")
    for estimate in found.estimates:
        cells = [
            _number(estimate.value, estimate.half_width),
            f"{estimate.half_width:.2g}",
            estimate.unit,
            "" if estimate.configured is None else f"{estimate.configured:.5g}",
        ]
        if truth:
            cells += _beside(estimate)
        colour = _COLOURS.get(estimate.verdict, "red")
        table.add_row(estimate.text, *cells, f"[{colour}]{estimate.verdict}[/]")
    console.print(table)
    for response in found.responses:
        rest = 100.0 * (1.0 - response.quality)
        peaks = ", ".join(f"{line.frequency:.2f}" for line in response.lines)
        console.print(
            f"{response.kind}: M, C and K leave {rest:.2g} % of the force's power unexplained; "
            f"peaks at {peaks} Hz"
        )
    for note in found.notes:
        console.print(escape(note), style="yellow")


def _number(value: float, half_width: float) -> str:
    return f"{rounded(value, half_width):.8g}"


def _beside(estimate: Estimate) -> list[str]:
    if estimate.truth is None:
        return ["", ""]
    error = estimate.value - estimate.truth
    share = f"{100.0 * error / estimate.truth:+.2f} %" if estimate.truth else f"{error:+.2g}"
    return [f"{estimate.truth:.5g}", share]
