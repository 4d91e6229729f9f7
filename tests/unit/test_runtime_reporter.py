"""When the reporter says that the tracker is lost: while poses are asked for and none is used."""

from __future__ import annotations

import pytest
from statue import CONFIG, CONTROL, POSE_TICKS, Statue

from tonus.runtime.operation.reporter import Reporter
from tonus.runtime.states import State, StopMode

PATIENCE = round(CONFIG.tracker.maximum_age_ms * 1e-3 / CONTROL.rates.period)
"""ticks without a pose until it is an event"""


class Watched:
    """A statue whose reporter's events of the tracker are kept."""

    def __init__(self, state: State) -> None:
        self.told: list[str] = []
        self.statue = Statue().until(state)
        self.reporter = Reporter(CONFIG, self.statue.cycle, self.statue.image, self._keep)
        self.tick(POSE_TICKS)  # it has looked at no tick before
        self.told.clear()

    def _keep(self, _ns: int, _tick: int, _level: int, name: str, _where: str, _text: str) -> None:
        if name.startswith("tracker_"):
            self.told.append(name)

    def tick(self, count: int, *, hidden: bool = False, silent: int = 0) -> None:
        """``count`` ticks, in which the tracker is ``hidden`` and the first ``silent`` cells report
        a defect."""
        for _ in range(count):
            image = self.statue.report()
            image.cells["status"][:silent] = 1
            if hidden:
                image.tracker["fresh"] = False
            self.statue.step()
            self.reporter.look(0, self.statue.number)


@pytest.fixture
def passive() -> Watched:
    """In a passive stop, since four cables are excluded."""
    watched = Watched(State.ACTIVE)
    watched.tick(PATIENCE)
    watched.tick(2, silent=4)
    assert watched.statue.cycle.sequence.stop_mode is StopMode.PASSIVE
    return watched


def test_a_stop_that_estimates_nothing_loses_no_tracker(passive: Watched) -> None:
    """It accepts no pose, because it asks for none."""
    sequence = passive.statue.cycle.sequence
    for _ in range(3 * PATIENCE):
        passive.tick(1, silent=4)
        assert not passive.statue.record.tracker.accepted
    assert sequence.state is State.SAFE_STOP
    assert passive.told == []


def test_there_a_hidden_tracker_is_reported_and_its_return(passive: Watched) -> None:
    passive.tick(2 * PATIENCE, silent=4, hidden=True)
    assert passive.told == ["tracker_lost"]
    passive.tick(PATIENCE, silent=4)
    assert passive.told == ["tracker_lost", "tracker_back"]


def test_where_the_pose_is_estimated_a_hidden_tracker_is_reported() -> None:
    watched = Watched(State.ACTIVE)
    watched.tick(3 * PATIENCE)
    assert watched.told == []
    watched.tick(2 * PATIENCE, hidden=True)
    assert watched.told == ["tracker_lost"]
