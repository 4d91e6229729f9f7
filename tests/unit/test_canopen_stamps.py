"""A frame's time on our clock, whatever clock its bus keeps, or none."""

from __future__ import annotations

from tonus.drivers.canopen.stamps import WINDOW_NS, Stamps

MS = 1_000_000
HOUR = 3_600_000 * MS
EPOCH = 1_700_000_000_000 * MS


def test_a_bus_on_our_clock_is_taken_at_its_word() -> None:
    stamps = Stamps()
    assert stamps.of(5_000 * MS, 5_000 * MS + 300_000) == 5_000 * MS
    assert stamps.exact
    # Even where every frame waits, and after a second in which nobody read.
    assert stamps.of(5_001 * MS, 9_000 * MS) == 5_001 * MS
    # A frame that came while we were reading is not from the future.
    assert stamps.of(9_100 * MS, 9_000 * MS) == 9_000 * MS


def test_a_bus_without_stamps_counts_frames_as_they_are_read() -> None:
    stamps = Stamps()
    assert [stamps.of(0, now) for now in (7, 1_000 * MS, 90_000 * MS)] == [
        7,
        1_000 * MS,
        90_000 * MS,
    ]
    assert not stamps.exact


def test_a_clock_that_drifts_is_followed() -> None:
    """100 ppm fast or slow, read once a millisecond with 50 to 950 us of delay."""
    for drift in (-1e-4, 1e-4):
        stamps = Stamps()
        worst = 0
        for tick in range(60_000):
            now = tick * MS
            true = now - 50_000 - (tick * 7919) % 900_000
            seen = stamps.of(EPOCH + round(true * (1.0 + drift)), now)
            assert seen <= now
            if tick * MS > 2 * WINDOW_NS:
                worst = max(worst, abs(seen - true))
        assert not stamps.exact
        assert worst < 300_000


def test_a_clock_that_is_set_is_found_again() -> None:
    stamps = Stamps()
    assert stamps.of(EPOCH, 0) == 0
    assert stamps.of(EPOCH + HOUR, 1 * MS) == 1 * MS
    assert stamps.of(EPOCH + HOUR + MS, 3 * MS) == 2 * MS
    assert stamps.of(EPOCH, 4 * MS) == 4 * MS
