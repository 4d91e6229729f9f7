"""What a run in the lab has to keep, judged against the truth."""

from __future__ import annotations

from tonus.config.schema.base import NonNegative, Positive, Section, Share


class FreeFall(Section):
    share: Share
    """of gravity that the platform is accelerated with downwards"""
    longest: Positive
    """s"""


class AfterFault(Section):
    """A bound that is wider for a moment after each fault."""

    force: Positive
    """N"""
    within: Positive
    """s after the fault"""


class Bounds(Section):
    tension: Positive
    """true tension, as a multiple of T_max"""
    speed: Positive
    """m/s, of the platform's origin"""
    falling_from: Positive
    """s after a fault: from here on no speed is reached that was not reached before"""
    quiet_speed: Positive
    """m/s; a speed below it needs not fall: a run goes on, or the platform is lowered"""
    free_fall: FreeFall
    contact: AfterFault
    """beside `control.envelope.contact_limit`"""
    named_within: Positive
    """s from a fault to an event that names its place"""
    settle: NonNegative
    """s of grace for times that are known to the tick only, as those taken from a log"""
    found_within: dict[str, Positive]
    """s by kind of a robot's fault: from the fault, as the isolation table of docs/stop_measured.md
    has it, to the controller's finding it"""
