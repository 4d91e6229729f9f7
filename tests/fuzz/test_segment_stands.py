"""A few thousand frames at the emulated EtherCAT segment; `make fuzz` fires the storm."""

from __future__ import annotations

from tests.fuzz.segment import fuzz_segment


def test_random_and_mutated_frames_leave_the_segment_standing() -> None:
    target = fuzz_segment(seed=7, frames=4000)
    assert target.answered > 3000
    assert {"INIT", "OP"} <= set(target.reached)
