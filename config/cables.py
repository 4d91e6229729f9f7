"""How many cables a robot has, and load cells. Apart from the schema, for which a record of the
tick and a first picture of it do not wait."""

from __future__ import annotations

LEAST_CABLES, MOST_CABLES = 6, 12
"""Fewer do not hold a platform in six directions, even under gravity; more have not been tried."""


def cells_of(cables: int) -> int:
    """Load cells of a robot: one for each cable and, last, the contact port's."""
    return cables + 1
