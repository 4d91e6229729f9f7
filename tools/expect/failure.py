"""An expectation that a run did not meet."""

from __future__ import annotations

from collections.abc import Sequence

from tonus.runtime.recording.taps import Level
from tonus.tools.expect.timeline import Timeline
from tonus.tools.log.log import Event

SHOWN = 10
"""events in the message"""
ERRORS = 6
"""of these, errors that come before others"""


class ExpectationError(AssertionError):
    """A run was not as expected. The text has the figure with its time, and below it ten events:
    the last up to then, or, of what was expected from a time on, those from that time on, errors
    before others.

    ``figure`` is the first line, ``time`` in s since the log's first message (None where the
    expectation concerns the whole run), ``events`` the events shown.
    """

    def __init__(
        self,
        figure: str,
        timeline: Timeline,
        events: Sequence[Event],
        time: float | None = None,
        since: float | None = None,
    ) -> None:
        self.figure, self.time = figure, time
        until = len(events) if time is None else timeline.before(events, time)
        start = 0 if since is None else timeline.until(events, since)
        head = "the last events:" if time is None else "the last events until then:"
        if since is not None and start < until:
            found = timeline.last(events[start:until], until - start)
            shown = _most_telling(found, time is not None)
            head = f"the events from {since:.3f} s on{'' if time is None else ' until then'}"
            few = f", {len(shown)} of {len(found)}, errors before others"
            head += f"{few if len(shown) < len(found) else ''}:"
        else:
            shown = timeline.last(events[:until], SHOWN)
        self.events = tuple(event for group in shown for event in group)
        told = [head, *timeline.each(shown)] if shown else ["no event was recorded until then"]
        super().__init__("\n".join([figure, *told]))


def _most_telling(told: list[list[Event]], with_last: bool) -> list[list[Event]]:
    """At most `SHOWN`, in order of time: the first errors, and the first of the rest; with the last
    one where that is the event that the figure is about."""
    ends = [len(told) - 1] if with_last else []
    errors = [at for at, group in enumerate(told) if group[0].level >= Level.ERROR]
    ranked = dict.fromkeys([*ends, *errors[:ERRORS], *range(len(told))])
    return [told[at] for at in sorted(list(ranked)[:SHOWN])]
