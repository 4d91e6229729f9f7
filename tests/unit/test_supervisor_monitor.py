"""What the daemon makes of a supervisor whose heartbeat has ended: drives that do not stop."""

from __future__ import annotations

from itertools import count
from types import SimpleNamespace
from typing import Any

import pytest

from tonus.config import load
from tonus.config.schema.supervisor import Requirement
from tonus.drivers.canopen.identifiers import EMCY, HEARTBEAT
from tonus.drivers.canopen.supervisor_monitor import (
    EMERGENCY,
    ERROR_CODE,
    NOWHERE,
    SupervisorMonitor,
)
from tonus.drivers.events import EventLog
from tonus.drivers.process_image import AxisState, ProcessImage

SUPERVISOR = load("config/can.yaml")[0].supervisor
assert SUPERVISOR is not None
TWICE = 2 * SUPERVISOR.timeout_ms
"""ticks"""


class Watching:
    """Two channels, of which the second one's drives are axes 2 and 3; 4 waits for nobody."""

    def __init__(self, policy: str = "use") -> None:
        assert SUPERVISOR is not None
        settings = SUPERVISOR.model_copy(update={"policy": policy})
        self.image = ProcessImage(5)
        self.events = EventLog()
        self.monitor = SupervisorMonitor(settings, 1000, self.image, self.events)
        self.channels: list[Any] = [SimpleNamespace(name=f"can{n}", handlers={}) for n in (0, 1)]
        for channel, axes in zip(self.channels, ([0, 1], [2, 3]), strict=True):
            self.monitor.listen(channel, axes)
        self.axes = self.image.axes
        self.axes["state"], self.axes["age"] = AxisState.OPERATION_ENABLED, 0
        self._ticks = count()

    def single(self, *numbers: int) -> bool:
        for number in numbers:
            assert SUPERVISOR is not None
            self.channels[number].handlers[HEARTBEAT + SUPERVISOR.node_id](b"\5")
        return self.look()

    def beat(self, *numbers: int) -> None:
        """Two heartbeats, the second of which says that it holds the drives."""
        for _ in range(2):
            self.single(*numbers)

    def look(self, ticks: int = 1) -> bool:
        for _ in range(ticks):
            self.monitor.look(next(self._ticks))
        return self.monitor.ignored


@pytest.fixture
def watching() -> Watching:
    return Watching()


def test_drives_that_stay_enabled_twice_as_long_as_they_should(watching: Watching) -> None:
    assert not watching.look(3 * TWICE), "it was never there"
    watching.beat(0, 1)
    assert not watching.look(TWICE)
    assert watching.look()
    watching.beat(0, 1)
    assert not watching.look(TWICE), "it is back"
    assert watching.look()
    watching.monitor.forget()
    assert not watching.monitor.ignored


@pytest.mark.parametrize("policy", ["use", "require"])
def test_drives_that_did_not_stop_are_not_armed_before_a_reset(policy: str) -> None:
    """What they wait for is in doubt, until a bring-up has written it anew."""
    watching = Watching(policy)
    watching.beat(0, 1)
    assert not watching.look(TWICE)
    assert not watching.monitor.doubt
    assert watching.look()
    watching.axes["state"] = AxisState.FAULT
    watching.beat(0, 1)
    assert not watching.monitor.ignored
    (obstacle,) = watching.image.obstacles.values()
    assert obstacle.startswith("a device did not stop without its heartbeat")
    assert obstacle.endswith("emergency stop, then reset")
    watching.monitor.doubt = False
    watching.beat(0, 1)
    assert not watching.image.obstacles


def test_single_heartbeats_hold_no_drive(watching: Watching) -> None:
    """Under `require` it sends one now and then to drives that have power though it is silent: each
    begins their watch, and ends it. Two in one tick, after a stall of the daemon, are two."""
    for _ in range(5):
        assert not watching.single(0, 1), "it was never there"
        watching.look(TWICE + 2)
    watching.beat(0, 1)
    assert not watching.look(TWICE // 2 + 1)
    assert not watching.single(0, 1)
    for _ in range(3):
        assert watching.look(TWICE // 2 + 1)
        assert watching.single(0, 1)
    for _ in range(2):
        assert SUPERVISOR is not None
        watching.channels[0].handlers[HEARTBEAT + SUPERVISOR.node_id](b"\5")
        watching.channels[1].handlers[HEARTBEAT + SUPERVISOR.node_id](b"\5")
    assert not watching.look(TWICE)


def test_a_drive_that_says_nothing_may_have_stopped(watching: Watching) -> None:
    watching.beat(0, 1)
    watching.look(TWICE)
    for age in range(1, TWICE):
        watching.axes["age"] = age
        assert not watching.look()
    watching.axes["age"][3] = TWICE - 1
    assert watching.look(), "it has answered once more"


def test_a_channel_is_one_for_itself(watching: Watching) -> None:
    """Not those that hear it still, and one drive of those that do not is enough."""
    watching.beat(0, 1)
    for _ in range(TWICE + 2):
        watching.single(0)
    assert watching.monitor.ignored
    watching.axes["state"][3] = AxisState.FAULT
    assert watching.look()
    watching.axes["state"][2] = AxisState.FAULT
    assert not watching.look(TWICE // 4), "all have obeyed"


def test_drives_that_are_enabled_after_a_loss_wait_for_nobody(watching: Watching) -> None:
    """Where it is not required: a watch begins with the first heartbeat."""
    watching.beat(0, 1)
    watching.axes["state"] = AxisState.FAULT
    assert not watching.look(TWICE)
    watching.axes["state"] = AxisState.OPERATION_ENABLED
    assert not watching.look(2 * TWICE)
    watching.beat(0, 1)
    assert watching.look(TWICE + 1), "lost once more"


def test_drives_without_a_second_consumer_are_not_asked_to_stop() -> None:
    watching = Watching()
    watching.beat(0, 1)
    watching.axes["state"][:4] = AxisState.FAULT
    assert not watching.look(2 * TWICE)


def test_drives_that_are_enabled_after_a_loss_where_it_is_required() -> None:
    """Nothing may arm them then: those that are all the same do not wait for it."""
    watching = Watching("require")
    watching.axes["state"] = AxisState.SWITCH_ON_DISABLED
    watching.beat(0, 1)
    assert not watching.look(3 * TWICE)
    watching.axes["state"][1] = AxisState.OPERATION_ENABLED
    assert watching.look()
    watching.beat(0, 1)
    assert not watching.look()


def test_what_one_waits_for_that_has_stopped_the_robot() -> None:
    assert SUPERVISOR is not None
    watching = Watching("require")
    watching.axes["state"] = AxisState.SWITCH_ON_DISABLED
    watching.beat(0, 1)
    emergency = EMERGENCY.pack(ERROR_CODE + Requirement.TICK, 0x81, NOWHERE, 6.0)
    watching.channels[0].handlers[EMCY + SUPERVISOR.node_id](emergency)
    assert not watching.image.obstacles
    watching.look(3 * TWICE)
    silent = "is not heard on can0, can1"
    (told,) = watching.image.obstacles.values()
    assert told == f"{silent}; it has stopped the robot: emergency stop, then reset"
    watching.single(0, 1)
    watching.look(3 * TWICE)
    assert next(iter(watching.image.obstacles.values())).endswith("emergency stop, then reset")
    watching.beat(0, 1)
    watching.look(3 * TWICE)
    assert list(watching.image.obstacles.values()) == [silent]


def test_single_heartbeats_arm_no_robot() -> None:
    """One that is required has to hold the drives, on each channel, before they are enabled."""
    watching = Watching("require")
    for _ in range(3):
        watching.single(0, 1)
        assert watching.image.obstacles
        watching.look(TWICE)
    watching.beat(0)
    assert list(watching.image.obstacles.values()) == ["is not heard on can1"]
    watching.beat(0, 1)
    assert not watching.image.obstacles
    watching.look(TWICE // 2)
    assert not watching.image.obstacles
    watching.look()
    assert watching.image.obstacles


def test_single_heartbeats_do_not_bring_it_back() -> None:
    """After a stop, under `require`, they go to drives that may have power."""
    watching = Watching("require")
    watching.axes["state"] = AxisState.SWITCH_ON_DISABLED
    watching.beat(0, 1)
    watching.look(TWICE)
    assert [each.name for each in watching.events.take()] == ["supervisor_lost"] * 2
    for _ in range(4):
        watching.single(0, 1)
        watching.look(TWICE)
    assert not watching.events.take()
    watching.single(0)
    watching.beat(1)
    (back,) = watching.events.take()
    assert (back.name, back.where) == ("supervisor_back", "can1")
    watching.single(0)
    (back,) = watching.events.take()
    assert (back.name, back.where) == ("supervisor_back", "can0")
    watching.look(TWICE)
    assert [each.name for each in watching.events.take()] == ["supervisor_lost"] * 2
