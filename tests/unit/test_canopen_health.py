"""A channel in trouble: what its controller says of it becomes events, once an episode."""

from __future__ import annotations

from collections.abc import Callable

import can
import pytest
from fake_can import Robot, in_virtual_time

from tonus.config import load
from tonus.drivers.canopen.health import Condition, Health
from tonus.drivers.events import EventLog
from tonus.drivers.process_image import AxisState

CONFIG = load("config/can.yaml")[0]
MASTER = CONFIG.fieldbus.master


def run(script: Callable[[Robot], None]) -> None:
    async def work() -> None:
        robot = Robot()
        await robot.start()
        try:
            script(robot)
        finally:
            for bus in robot.buses.values():
                bus.refuses = bus.deaf = False
            await robot.fieldbus.stop()

    in_virtual_time(work())


def ticks(robot: Robot, first: int, count: int, silent: str = "") -> list[str]:
    """Names and places of the events of some ticks in which every node answers but those of a
    channel."""
    told = []
    for tick in range(first, first + count):
        if tick:
            robot.put_all()
        if tick % 50 == 0:
            robot.put_heartbeats()
        if silent:
            robot.buses[silent].inbox.clear()
        robot.fieldbus.collect(tick)
        robot.fieldbus.publish(tick)
        told += [f"{event.name} {event.where}" for event in robot.fieldbus.take_events()]
    return told


def test_the_controllers_state_is_asked_for_and_every_change_is_told_once() -> None:
    def script(robot: Robot) -> None:
        bus, every = robot.buses["can2"], MASTER.health_ticks
        assert ticks(robot, 0, 2 * every) == []
        bus.condition = can.BusState.PASSIVE
        assert ticks(robot, 2 * every, 2 * every) == ["bus_passive can2"]
        bus.condition = can.BusState.ERROR
        assert ticks(robot, 4 * every, 2 * every) == ["bus_off can2"]
        bus.condition = can.BusState.ACTIVE
        assert ticks(robot, 6 * every, 2 * every) == ["bus_recovered can2"]

    run(script)


def test_a_controller_that_is_gone_is_told_once_an_episode() -> None:
    def script(robot: Robot) -> None:
        robot.buses["can1"].condition = None
        assert ticks(robot, 0, 50) == ["bus_deaf can1"]
        robot.buses["can1"].condition = can.BusState.ACTIVE
        assert ticks(robot, 50, 50) == []
        robot.buses["can1"].condition = None
        assert ticks(robot, 100, 50) == ["bus_deaf can1"]

    run(script)


@pytest.mark.parametrize(
    ("classes", "data", "condition", "names"),
    [
        (0x040, b"", Condition.OFF, ["bus_off"]),
        (0x004, b"\0\x20", Condition.PASSIVE, ["bus_passive"]),
        (0x004, b"\0\x10", Condition.PASSIVE, ["bus_passive"]),
        (0x004, b"\0\x08", Condition.ACTIVE, []),  # a warning is not worth a word
        (0x004, b"\0\x01", Condition.ACTIVE, ["bus_error"]),
        (0x004, b"", Condition.ACTIVE, []),
        (0x020, bytes(8), Condition.ACTIVE, ["bus_error"]),
        (0x088, bytes(8), Condition.ACTIVE, ["bus_error"]),
        (0x1FFFFFFF, b"\xff" * 8, Condition.OFF, ["bus_off", "bus_error", "bus_error"]),
    ],
)
def test_error_frames_are_read_as_socketcan_writes_them(
    classes: int, data: bytes, condition: Condition, names: list[str]
) -> None:
    events = EventLog()
    health = Health("can0", can.Bus(interface="virtual", channel="health"), events)
    health.error_frame(classes, data)
    assert health.condition is condition
    assert [event.name for event in events.take()] == names
    # This interface has no state of its own: asking it must not end what error frames began.
    health.look()
    assert health.condition is condition
    health.error_frame(0x100, b"")
    assert health.condition is Condition.ACTIVE
    recovered = [event.name for event in events.take()]
    assert recovered == (["bus_recovered"] if condition else [])


def test_an_error_frame_reaches_the_channel_it_came_from() -> None:
    def script(robot: Robot) -> None:
        ticks(robot, 0, 5)
        robot.buses["can3"].put(0x004, b"\0\x20\0\0\0\0\0\0", is_error_frame=True)
        assert ticks(robot, 5, 1) == ["bus_passive can3"]

    run(script)


def test_a_deaf_channel_is_told_once_and_costs_its_own_axes_only() -> None:
    def script(robot: Robot) -> None:
        ticks(robot, 0, 5)
        robot.buses["can1"].deaf = True
        assert ticks(robot, 5, 8) == ["bus_deaf can1", "bus_stalled can1"]
        states = robot.image.axes["state"]
        assert list(states == AxisState.LOST) == [axis in (2, 4) for axis in range(8)]
        robot.buses["can1"].deaf = False
        robot.buses["can1"].inbox.clear()
        ticks(robot, 13, 30)
        assert set(states) == {AxisState.OPERATION_ENABLED}

    run(script)


def test_a_channel_that_never_runs_dry_is_flooded() -> None:
    def script(robot: Robot) -> None:
        bus = robot.buses["can0"]
        ticks(robot, 0, 5)
        for _ in range(2000):
            bus.put(0x181, bytes(8))
        told = ticks(robot, 5, MASTER.flood_ticks)
        assert told.count("bus_flooded can0") == 1
        assert "duplicate_pdo can0/1" in told
        bus.inbox.clear()
        assert "bus_flooded can0" not in ticks(robot, 10, 20)

    run(script)


def test_a_node_that_lives_but_answers_no_sync_is_told_once_an_episode() -> None:
    def script(robot: Robot) -> None:
        told = ticks(robot, 0, 100, silent="can2")
        silent = {f"silent_pdo can2/{node}" for node in (4, 6, 20, 22)}
        assert set(told) == {"bus_stalled can2", *silent}
        assert len(told) == 5

    run(script)


def test_what_waits_to_be_sent_is_dropped_once_when_nobody_answers() -> None:
    def script(robot: Robot) -> None:
        fresh = CONFIG.control.freshness.measurement_ticks
        can2 = robot.buses["can2"]
        ticks(robot, 0, 20)
        ticks(robot, 20, fresh, silent="can2")
        assert can2.flushes == 0
        assert "bus_stalled can2" in ticks(robot, 20 + fresh, 5, silent="can2")
        assert can2.flushes == 1
        ticks(robot, 30, 10)
        can2.refuses = True  # a queue that is full before the measurements are old
        ticks(robot, 40, fresh + 1, silent="can2")
        assert can2.flushes == 2
        assert not any(robot.buses[f"can{n}"].flushes for n in (0, 1, 3))

    run(script)


def test_strangers_that_fill_a_channel_are_a_flood() -> None:
    def script(robot: Robot) -> None:
        bus = robot.buses["can0"]
        ticks(robot, 0, 5)
        told = []
        for tick in range(5, 5 + MASTER.flood_ticks):
            for _ in range(MASTER.flood_frames):
                bus.put(0x000, bytes(2))
            told.append(ticks(robot, tick, 1))
        assert ["bus_flooded can0" in names for names in told] == [
            *[False] * (MASTER.flood_ticks - 1),
            True,
        ]

    run(script)


def test_every_event_names_its_place_and_says_what_is_done() -> None:
    def script(robot: Robot) -> None:
        robot.buses["can2"].condition = can.BusState.ERROR
        robot.fieldbus.collect(0)
        robot.fieldbus.publish(0)
        (event,) = robot.fieldbus.take_events()
        assert event.where == "can2"
        assert event.text.endswith("; every axis and cell of the channel goes stale")

    run(script)
