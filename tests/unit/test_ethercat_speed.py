"""Process data of a usual map go through all slaves at once; what that gains, as a ratio."""

from __future__ import annotations

from tests.bench.segment import both_ways

QUICKER_BY = 2.0
"""times at least"""


def test_all_slaves_at_once_take_half_of_one_after_the_other() -> None:
    straight, by_parts = both_ways()
    assert by_parts >= QUICKER_BY * straight
