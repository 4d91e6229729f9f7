"""What can go wrong with the lab itself, as one line a person can act on."""

from __future__ import annotations


class LabError(Exception):
    """The lab cannot be built or cannot start."""
