"""The error of the lab."""

from __future__ import annotations


class LabError(Exception):
    """The lab cannot be built, cannot start, or refuses a fault; one line with the remedy."""
