"""The histogram against numpy, on values over nine magnitudes."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tonus.runtime.timing.histogram import RESOLUTION, Histogram


def filled(values: list[int]) -> Histogram:
    histogram = Histogram()
    for value in values:
        histogram.add(value)
    return histogram


@given(st.lists(st.integers(0, 10**10), min_size=1, max_size=200), st.floats(0.01, 1.0))
@settings(derandomize=True, deadline=None, max_examples=100)
def test_a_share_is_a_value_that_was_added_to_within_a_bin(values: list[int], share: float) -> None:
    exact = int(np.quantile(values, share, method="inverted_cdf"))
    found = filled(values).at(share)
    assert exact <= found <= exact * (1.0 + RESOLUTION) + 1


@given(st.lists(st.integers(0, 2**62), min_size=1, max_size=100))
@settings(derandomize=True, deadline=None, max_examples=100)
def test_every_value_is_counted_once_and_the_largest_kept(values: list[int]) -> None:
    histogram = filled(values)
    assert sum(count for _, count in histogram.filled()) == histogram.count == len(values)
    assert histogram.largest == max(values)
    uppers = [upper for upper, _ in histogram.filled()]
    assert uppers == sorted(set(uppers))


def test_two_merge_into_what_one_would_have_counted() -> None:
    both, first = filled([3, 70_000, 5_000_000_000]), filled([3])
    first.merge(filled([70_000, 5_000_000_000]))
    assert list(first.filled()) == list(both.filled())
    assert (first.count, first.largest) == (both.count, both.largest)


def test_what_is_early_counts_as_punctual_and_nothing_as_nothing() -> None:
    assert list(filled([-5, 0, 0]).filled()) == [(0, 3)]
    assert Histogram().at(0.5) == 0


def test_what_lies_beyond_is_counted() -> None:
    assert filled([900_000, 1_100_000, 5_000_000]).beyond(1_000_000) == 2
