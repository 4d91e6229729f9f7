"""How far a campaign has come, on standard output or standard error."""

from __future__ import annotations

from rich.console import Console

from tonus.tools.campaign.campaign import Standing

_STEPS = 20
"""lines of progress where there is no terminal"""


class Progress:
    """A line now and then; without a thread of its own, since processes are forked meanwhile."""

    def __init__(self, console: Console, bad: str) -> None:
        """``bad``: what is wrong with the episodes or runs that are counted apart."""
        self._console, self._bad, self._shown = console, bad, 0

    def __call__(self, standing: Standing) -> None:
        step = standing.done * _STEPS // standing.total
        line = f"  {standing.done}/{standing.total}  {standing.broken} {self._bad}  "
        line += f"{standing.left:.0f} s left"
        if self._console.is_terminal:
            self._console.print(line, end="\r" if standing.done < standing.total else "\n")
        elif step > self._shown:
            self._console.print(line)
        self._shown = step
