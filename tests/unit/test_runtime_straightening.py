"""How tensions grow before lengths are referenced, tick by tick."""

from __future__ import annotations

import numpy as np
import pytest

from tests.unit.sequence_setup import CONTROL, N
from tonus.runtime.safety.straightening import Straightening

TICK = 0.001
TAUT = np.full(N, 3.0)


def made(slack: float = 6.0, tolerated: float = 0.002, longest: float = 0.004) -> Straightening:
    """To 12 N in 4 ms; a cable below half of ``slack`` N is slack."""
    times = {"referencing_settle_s": 0.008, "slack_s": tolerated, "take_up_s": longest}
    tension = CONTROL.tension.model_copy(update={"slack": slack, "referencing": 12.0})
    sequence = CONTROL.sequence.model_copy(update=times)
    return Straightening(CONTROL.model_copy(update={"tension": tension, "sequence": sequence}))


def loose(*cables: int) -> np.ndarray:
    tension = TAUT.copy()
    tension[list(cables)] = 2.99
    return tension


def ticks(one: Straightening, tension: np.ndarray, first: int, count: int) -> list[float]:
    """Shares, while no cable has been slack for too long."""
    shares = []
    for number in range(first, first + count):
        assert one.take_up(number * TICK, tension) == []
        shares.append(one.grow(number * TICK))
    return shares


def test_tensions_grow_and_then_settle() -> None:
    one = made()
    assert one.share == 0.0
    assert ticks(one, TAUT, 0, 6) == [0.0, 0.25, 0.5, 0.75, 1.0, 1.0]
    assert one.settled(0.007) == pytest.approx(-0.001)
    assert one.settled(0.009) == pytest.approx(0.001)


def test_slack_counts_from_the_tension_on_up_to_which_all_may_be_slack() -> None:
    """From tick 2 on half of the tension is asked for; three ticks later they are back at it."""
    one = made()
    assert ticks(one, loose(5), 0, 5) == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert ticks(one, loose(5), 5, 2) == pytest.approx([0.5, 0.5])
    assert one.settled(0.006) == pytest.approx(-0.006)
    assert one.waits_for == [5]
    assert one.take_up(0.007, loose(5, 2)) == [2, 5]


def test_a_cable_that_was_taut_meanwhile_has_its_time_anew() -> None:
    one = made()
    ticks(one, loose(5), 0, 5)
    assert one.waits_for == []
    ticks(one, TAUT, 5, 1)
    assert ticks(one, loose(5), 6, 2) == [1.0, 1.0]
    assert ticks(one, loose(5), 8, 1) == pytest.approx([0.5])


def test_slack_is_counted_however_the_share_is_rounded() -> None:
    """It is a tick's rounding beside that from which on it counts."""
    one = made(slack=7.0, tolerated=0.0, longest=0.5005)
    shares = ticks(one, np.zeros(N), 0, 504)
    assert min(shares[4:]) < 7.0 / 12.0, "or this tries nothing"
    assert one.take_up(504 * TICK, np.zeros(N)) == list(range(N))


def test_it_begins_anew() -> None:
    one = made()
    ticks(one, loose(5), 0, 7)
    assert one.waits_for == [5]
    one.begin()
    assert (one.share, one.waits_for) == (0.0, [])
    assert ticks(one, loose(5), 0, 5) == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_none_is_waited_for_any_more_once_all_pull() -> None:
    one = made()
    ticks(one, loose(5), 0, 7)
    ticks(one, TAUT, 7, 1)
    assert one.waits_for == []


def test_without_a_time_for_it_none_waits() -> None:
    one = made(tolerated=0.0, longest=0.0)
    assert ticks(one, loose(5), 0, 6) == [0.0, 0.25, 0.5, 0.75, 1.0, 1.0]
