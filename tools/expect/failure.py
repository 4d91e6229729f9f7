"""An expectation that a run did not meet."""

from __future__ import annotations

from collections.abc import Sequence

from tonus.tools.expect.timeline import Timeline
from tonus.tools.log.log import Event

SHOWN = 10
"""events in the message"""


class ExpectationError(AssertionError):
    """A run was not as expected. The text has the figure with its time, and below it the last ten
    events up to then.

    ``figure`` is the first line, ``time`` in s since the log's first message (None where the
    expectation concerns the whole run), ``events`` the events shown.
    """

    def __init__(
        self,
        figure: str,
        timeline: Timeline,
        events: Sequence[Event],
        time: float | None = None,
    ) -> None:
        self.figure, self.time = figure, time
        until = len(events) if time is None else timeline.before(events, time)
        shown = timeline.last(events[:until], SHOWN)
        self.events = tuple(event for group in shown for event in group)
        super().__init__("\n".join([figure, *self._told(timeline)]))

    def _told(self, timeline: Timeline) -> list[str]:
        if not self.events:
            return ["no event was recorded until then"]
        head = "the last events:" if self.time is None else "the last events until then:"
        return [head, *timeline.lines(self.events, SHOWN)]
