"""Heartbeats that are counted: which wait in a transmit queue, and which were lost."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest

from tests.unit.supervisor_setup import STRICT
from tonus.config import Config, load
from tonus.runtime.supervisor.heartbeat import Beats
from tonus.runtime.supervisor.listener import Heard


@pytest.fixture(scope="module")
def config() -> Config:
    return load("config/can.yaml", overrides=STRICT)[0]


def beating(config: Config, period_ms: int = 2) -> tuple[Beats, Heard]:
    """Heartbeats of which the interface has told, each at once, for long."""
    assert config.supervisor is not None
    heard = Heard(())
    beats = Beats(0x77E, heard, period_ms, config.supervisor.timeout_ms)
    beats.send()
    heard.take([5], 0)
    return beats, heard


def but_for(missing: int, of: int, most: int) -> Callable[[int], int]:
    return lambda look: most * (look % of >= missing)


def at_random(share: float, most: int, seed: int) -> Callable[[int], int]:
    draw = random.Random(seed)
    return lambda _: most * (draw.random() < share)


@pytest.mark.parametrize(
    "leaving",
    [
        *(but_for(missing, 20, most) for missing in (1, 2, 3) for most in (1, 9)),
        *(but_for(missing, of, 1) for missing, of in ((1, 2), (1, 3), (2, 3), (4, 5))),
        *(at_random(share, 1, seed) for share in (0.5, 0.7, 0.8, 0.9, 0.99) for seed in range(4)),
        *(at_random(share, 2, 4) for share in (0.5, 0.8, 0.95)),
    ],
)
def test_however_late_a_queue_lets_heartbeats_out_two_wait_at_most(
    config: Config, leaving: Callable[[int], int]
) -> None:
    """``leaving``: how many may go out between one look and the next. In 20 s none is given up that
    waits."""
    beats, heard = beating(config)
    queue = most = sent = 0
    for look in range(10_000):
        follows = beats.follows()
        if follows:
            beats.send()
        queue, sent = queue + follows, sent + follows
        most = max(most, queue)
        out = min(leaving(look), queue)
        if out:
            heard.take([5] * out, look)
        queue -= out
    assert most <= 2
    assert sent > 1000, "it goes on"


def test_one_look_at_least_shows_that_nothing_waits(config: Config) -> None:
    """Where drives wait hardly longer than two looks take."""
    beats, heard = beating(config, period_ms=10)
    for _ in range(2):
        assert beats.follows()
        beats.send()
    heard.take([5], 2)
    assert not beats.follows()
    heard.take([5], 3)
    assert beats.follows()


@pytest.mark.parametrize(("looks", "second"), [(15, False), (16, True)])
def test_a_second_one_only_where_sixteen_before_went_out_at_once(
    config: Config, looks: int, second: bool
) -> None:
    """After two that were late and not lost."""
    beats, heard = beating(config)
    for _ in range(2):
        assert beats.follows()
        beats.send()
    for look in range(looks):
        heard.take([5, 5] if look == 0 else [5], look)
        assert beats.follows()
        beats.send()
    assert beats.follows() is second


@pytest.mark.parametrize(("period_ms", "looks"), [(2, 5), (10, 2)])
def test_one_heartbeat_is_lost_now_and_then(config: Config, period_ms: int, looks: int) -> None:
    """Each time drives get the next one before half of their 22 ms is over, and the one after it;
    with looks of 10 ms one look later at least."""
    beats, heard = beating(config, period_ms)
    lost = {100, 200, 250, 300}
    last, longest = -1, 0
    for look in range(400):
        if not beats.follows():
            continue
        beats.send()
        if look in lost:
            continue
        heard.take([5], look)
        longest, last = max(longest, look - last), look
    assert longest == looks


def test_what_was_given_up_may_come_after_all(config: Config) -> None:
    """The one that was taken for lost waits, and the next lets that be seen."""
    beats, heard = beating(config)
    for _ in range(2):
        assert beats.follows()
        beats.send()
    heard.take([5], 2)
    while not beats.follows():  # no other comes
        pass
    beats.send()
    assert beats.waits
    heard.take([5], 9)
    assert beats.follows(), "as far as it counts"
    beats.send()
    heard.take([5, 5], 10)
    for look in range(40):  # none is left out to see whether it was lost
        assert beats.follows()
        beats.send()
        heard.take([5], look)


def test_one_that_was_sent_waits_once_the_interface_has_told_of_any(config: Config) -> None:
    """Until then each look sends one; then none before all but one have gone out."""
    assert config.supervisor is not None
    heard = Heard(())
    beats = Beats(0x77E, heard, 2, config.supervisor.timeout_ms)
    for _ in range(4):
        assert beats.follows()
        beats.send()
    assert not beats.waits
    heard.take([5], 1)
    assert beats.waits
    assert not beats.follows()
    heard.take([5], 2)
    assert not any(beats.follows() for _ in range(9)), "two wait, however long"
    heard.take([5], 3)
    assert beats.waits
    assert not beats.follows()
    heard.take([5], 4)
    assert not beats.waits
    assert beats.follows()


@pytest.mark.parametrize("into", range(8))
def test_whatever_was_lost_before_it_begins_is_over(config: Config, into: int) -> None:
    """One may be lost at once then, as at first."""
    beats, heard = beating(config)
    beats.send()
    for look in range(into):
        if beats.follows():
            beats.send()
            heard.take([5], look)
    beats.begin()
    assert beats.follows()
    beats.send()
    assert beats.follows(), "that one may be lost"
    beats.send()
    heard.take([5], 9)
    assert [beats.follows() for _ in range(5)] == [False] * 4 + [True]
