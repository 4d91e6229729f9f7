"""What a scenario's run has to have done: the expectations of an acceptance test.

Times are s since the log's first message; signals and topics are those of docs/log.md.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from tonus.config.schema.base import Finite, NonNegative, Positive, Section

StateName = Literal[
    "OFF", "STANDBY", "REFERENCING", "PRETENSION", "HOLD", "ACTIVE", "SAFE_STOP", "FAULT"
]


class Happens(Section):
    """An event, by name (``*`` and ``?`` as in file names)."""

    kind: Literal["event"]
    event: str
    where: str = ""
    """words of its place or text"""
    within: Positive | None = None
    """s after the first fault, or after ``after``"""
    after: NonNegative | None = None
    """s"""


class Never(Section):
    """No such event."""

    kind: Literal["never"]
    event: str
    where: str = ""
    """words of its place or text"""


class Allowed(Section):
    """A warning or an error that may come, or not; any other that no expectation names fails."""

    kind: Literal["allowed"]
    event: str


class Ends(Section):
    """The last state."""

    kind: Literal["ends"]
    state: StateName


class _OfSignal(Section):
    topic: str
    """with or without /tonus/"""
    field: str
    index: Annotated[int, Field(ge=0)] | None = None
    """one element of a vector, counted from 0"""
    norm: bool = False
    """the Euclidean length of a vector"""
    during: tuple[StateName, ...] = ()
    """only in these states"""
    start: NonNegative = 0.0
    """s, only from here"""
    end: Positive | None = None
    """s, only before this"""

    @model_validator(mode="after")
    def _one_of_both(self) -> _OfSignal:
        if self.norm and self.index is not None:
            raise ValueError("takes norm or index, not both; leave one out")
        if self.end is not None and not self.start < self.end:
            raise ValueError("start < end must hold")
        return self


class Stays(_OfSignal):
    """Every sample is in [low, high]."""

    kind: Literal["stays"]
    low: Finite
    high: Finite

    @model_validator(mode="after")
    def _an_interval(self) -> Stays:
        if self.low > self.high:
            raise ValueError("low <= high must hold")
        return self


class Settles(_OfSignal):
    """From ``within`` s after the part's begin on, every sample is in value +- band."""

    kind: Literal["settles"]
    value: Finite
    band: Positive
    within: NonNegative
    """s"""


class Rms(_OfSignal):
    """The root mean square about ``about``."""

    kind: Literal["rms"]
    at_most: NonNegative
    about: Finite = 0.0


class Figure(Section):
    """A number of summary.json."""

    kind: Literal["summary"]
    key: str
    """with dots, as k_eq_n_per_m.max"""
    at_most: Finite


class Invariants(Section):
    """What no run in the lab may do, against the plant's truth (docs/campaign.md)."""

    kind: Literal["invariants"]


class Replays(Section):
    """The log's inputs give its outputs again, bit for bit."""

    kind: Literal["replays"]


Expectation = Annotated[
    Happens | Never | Allowed | Ends | Stays | Settles | Rms | Figure | Invariants | Replays,
    Field(discriminator="kind"),
]
