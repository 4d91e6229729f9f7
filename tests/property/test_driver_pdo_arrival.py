"""No measurement is booked newer than it is, whatever happens to the answers on their way."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tonus.config import load
from tonus.config.schema.bus import CanopenBus
from tonus.drivers.canopen.syncs import HISTORY, Arrival, Syncs
from tonus.drivers.events import EventLog
from tonus.drivers.exchange import NOT_YET

BUS = load("config/can.yaml")[0].fieldbus
assert isinstance(BUS, CanopenBus)
MASTER = BUS.master
US = 1000
PERIOD_NS = 1_000_000
FRAME_NS = 114 * US
"""eight bytes and the space behind them at 1 Mbit/s, no bit stuffed"""
EARLIEST_NS = 155 * US
CALM = 12
TROUBLE = min(MASTER.settle_ticks, MASTER.late_ticks)


@dataclass(frozen=True)
class Answer:
    """What happens to the answer to one SYNC."""

    lost: bool
    delay_ns: int
    copies: int


answers = st.builds(
    Answer,
    lost=st.sampled_from([False, False, True]),
    delay_ns=st.one_of(
        st.sampled_from([0, 0, PERIOD_NS, 2 * PERIOD_NS]), st.integers(0, TROUBLE * PERIOD_NS)
    ),
    copies=st.sampled_from([1, 1, 1, 2]),
)
phases = st.integers(EARLIEST_NS, PERIOD_NS - FRAME_NS)


class Node:
    """Plays arrivals, as (time, SYNC they truly answer), to the bookkeeping."""

    def __init__(self, *, stamped: bool) -> None:
        self.syncs = Syncs()
        self.syncs.bit_ns = US if stamped else 0
        self.ticks = [NOT_YET]
        self.events = EventLog()
        self.arrival = Arrival(8, self.syncs, MASTER, self.events, "can0/1")
        self.held = NOT_YET
        self._stamped = stamped
        self.constant = False

    def play(self, arrivals: list[tuple[int, int]], ticks: int) -> list[int]:
        """Age of the measurement in each tick; none is younger than the one that is held."""
        ages = []
        waiting = sorted(arrivals)
        for tick in range(ticks):
            now = tick * PERIOD_NS
            while waiting and waiting[0][0] <= now:
                stamp, truth = waiting.pop(0)
                self.syncs.stamp_ns = stamp if self._stamped else now
                data = b"" if self.constant else truth.to_bytes(2, "little")
                if (booked := self.arrival.book(data)) is not None:
                    self.held, self.ticks = truth, [booked]
            assert self.ticks[0] <= self.held
            ages.append(tick - 1 - self.ticks[0])
            self.syncs.sent(tick, now)
        return ages


def in_order(trouble: list[Answer], phase: int, ticks: int) -> list[tuple[int, int]]:
    """A controller with one queue: an answer that waits keeps the later ones waiting."""
    arrivals = []
    free = 0
    end = (CALM + TROUBLE) * PERIOD_NS
    for tick in range(ticks):
        number = tick - CALM
        fate = trouble[number] if 0 <= number < len(trouble) else Answer(False, 0, 1)
        at = max(tick * PERIOD_NS + phase + fate.delay_ns, free)
        if fate.lost or (fate.delay_ns and at > end):
            continue
        # A SYNC would win the bus against a copy: one that is due keeps them apart.
        parted = (at - EARLIEST_NS) // PERIOD_NS != (at + FRAME_NS - EARLIEST_NS) // PERIOD_NS
        for copy in range(1 if parted else fate.copies):
            arrivals.append((at + copy * FRAME_NS, tick))
            free = at + (copy + 1) * FRAME_NS
    return arrivals


@settings(max_examples=300, derandomize=True, deadline=None)
@given(st.lists(answers, max_size=TROUBLE), phases)
def test_answers_lost_delayed_or_doubled_are_never_booked_as_newer(
    trouble: list[Answer], phase: int
) -> None:
    ticks = CALM + 3 * TROUBLE + 4
    ages = Node(stamped=True).play(in_order(trouble, phase, ticks), ticks)
    assert ages[2:CALM] == [0] * (CALM - 2)
    assert ages[-1] == 0


@settings(max_examples=150, derandomize=True, deadline=None)
@given(st.lists(answers.map(lambda a: Answer(a.lost, a.delay_ns, 1)), max_size=TROUBLE), phases)
def test_without_stamps_loss_and_delay_are_not_booked_as_newer_either(
    trouble: list[Answer], phase: int
) -> None:
    ticks = CALM + 3 * TROUBLE + 4
    ages = Node(stamped=False).play(in_order(trouble, phase, ticks), ticks)
    assert ages[-1] == 0


@settings(max_examples=150, derandomize=True, deadline=None)
@given(phases, st.integers(0, (TROUBLE - 1) * PERIOD_NS))
def test_one_answer_that_is_overtaken_by_later_ones_is_not_booked_as_newer(
    phase: int, delay_ns: int
) -> None:
    ticks = CALM + 3 * TROUBLE
    arrivals = [(tick * PERIOD_NS + phase, tick) for tick in range(ticks)]
    arrivals[CALM] = (arrivals[CALM][0] + delay_ns, CALM)
    assert Node(stamped=True).play(arrivals, ticks)[-1] == 0


def test_a_single_loss_costs_one_tick_of_age_until_it_is_known_to_be_one() -> None:
    node = Node(stamped=True)
    arrivals = [(tick * PERIOD_NS + EARLIEST_NS, tick) for tick in range(40) if tick != 20]
    ages = node.play(arrivals, 40)
    assert ages[21:] == [1] * (MASTER.settle_ticks + 1) + [0] * (18 - MASTER.settle_ticks)
    assert [event.name for event in node.events.take()] == ["missing_pdo"]


def test_frames_that_waited_unread_are_booked_to_their_own_time() -> None:
    """A backlog of our own: what was read late did not arrive late."""
    node = Node(stamped=True)
    for tick in range(5):
        node.syncs.sent(tick, tick * PERIOD_NS)
    for tick in range(4):
        node.syncs.stamp_ns = tick * PERIOD_NS + EARLIEST_NS
        assert node.arrival.book(bytes(8)) == tick
    assert node.events.take() == []


def test_a_frame_older_than_any_open_sync_is_not_used() -> None:
    node = Node(stamped=True)
    for tick in range(HISTORY + 10):
        node.syncs.sent(tick, tick * PERIOD_NS)
    node.syncs.stamp_ns = EARLIEST_NS
    assert node.arrival.book(bytes(8)) is None
    assert [event.name for event in node.events.take()] == ["late_pdo"]


@pytest.mark.parametrize("late", [1, 8, HISTORY - 1])
def test_a_long_silence_leaves_no_sample_younger_than_was_configured(late: int) -> None:
    syncs = Syncs()
    master = MASTER.model_copy(update={"late_ticks": late})
    arrival = Arrival(8, syncs, master, EventLog(), "")
    for tick in range(200):
        syncs.sent(tick, tick * PERIOD_NS)
    syncs.stamp_ns = 200 * PERIOD_NS
    assert arrival.book(bytes(8)) == 199 - late


@pytest.mark.parametrize("late_us", [1000, 1200])
def test_one_late_answer_with_constant_data_costs_age_once(late_us: int) -> None:
    """A cell that nothing touches says the same in every period."""
    node = Node(stamped=True)
    phase = EARLIEST_NS + 500 * US
    arrivals = [(tick * PERIOD_NS + phase, tick) for tick in range(40)]
    arrivals[20] = (20 * PERIOD_NS + EARLIEST_NS + late_us * US, 20)
    node.constant = True
    ages = node.play(arrivals, 40)
    assert max(ages[21:23]) <= 2
    assert ages[24:] == [0] * 16
