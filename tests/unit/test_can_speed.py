"""Both ways to receive from the lab's bus are quick; as ratios, since hosts differ."""

from __future__ import annotations

from tests.bench.frames import one_to_nine

SLOWER_AT_MOST = 1.5
"""times a message, of frames that come one by one"""


def test_arrays_cost_no_more_than_messages_and_both_less_than_python_cans_own_bus() -> None:
    by_message, by_array, virtual = one_to_nine()
    assert by_array <= SLOWER_AT_MOST * by_message
    assert max(by_message, by_array) < virtual
