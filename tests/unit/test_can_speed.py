"""Both ways to receive from the lab's bus are quick; as a ratio, since hosts differ."""

from __future__ import annotations

from tests.bench.frames import one_to_nine

SLOWER_AT_MOST = 1.5
"""times the quicker way, of frames that come one by one"""


def test_messages_and_arrays_cost_alike_and_less_than_python_cans_own_bus() -> None:
    by_message, by_array, virtual = one_to_nine()
    assert max(by_message, by_array) <= SLOWER_AT_MOST * min(by_message, by_array)
    assert max(by_message, by_array) < virtual
