"""collect and publish: what reaches the image and the bus, and what is told of the rest."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from fake_can import Robot, Tap, in_virtual_time

from tonus.config import load
from tonus.drivers.process_image import NEVER, AxisCommand, AxisState

INCREMENT = 2 * math.pi / (4096 * 49 / 4)


def run(script: Callable[[Robot], None], robot: Robot | None = None) -> Robot:
    made = robot or Robot()

    async def work() -> None:
        await made.start()
        script(made)
        await made.fieldbus.stop()

    in_virtual_time(work())
    return made


def names(robot: Robot) -> list[str]:
    """Of the events since the last call, but for channels on which a test lets nobody answer."""
    told = [event.name for event in robot.fieldbus.take_events()]
    return [name for name in told if name != "bus_stalled"]


def test_samples_of_the_last_sync_reach_the_image_in_si_units() -> None:
    def script(robot: Robot) -> None:
        bus, image = robot.fieldbus, robot.image
        bus.collect(0)
        assert set(image.axes["age"]) == {NEVER}
        assert set(image.axes["state"]) == {AxisState.LOST}
        robot.put_all(no_axis=frozenset({5}), no_cell=frozenset({8}))
        robot.put_axis(5, 0x1637, position=-50_176, torque=-250)
        robot.put_cell(8, -1234)
        bus.collect(1)
        assert image.axes["angle"][5] == pytest.approx(-2 * math.pi, rel=1e-12)
        assert image.axes["torque"][5] == pytest.approx(-0.25 * 0.568 * 49 / 4, rel=1e-12)
        assert image.axes["statusword"][5] == 0x1637
        assert image.cells["force"][8] == -12.34
        assert set(image.axes["age"]) == set(image.cells["age"]) == {0}
        assert set(image.axes["state"]) == {AxisState.OPERATION_ENABLED}

    run(script)


def test_every_channel_gets_one_sync_a_tick_before_any_rpdo() -> None:
    def script(robot: Robot) -> None:
        for tick in range(3):
            robot.fieldbus.collect(tick)
            robot.fieldbus.publish(tick)
        for bus in robot.buses.values():
            identifiers = [identifier for identifier, _ in bus.sent if identifier != 0x77F]
            rpdos = [0x200 + node.node_id for node in bus.nodes if node.node_id < 9]
            assert identifiers == [0x080, *rpdos] * 3

    run(script)


def test_a_sync_behind_frames_that_are_still_on_the_wire_goes_out_at_an_uncertain_time() -> None:
    """No time passes between these ticks: the second SYNC waits for the first, its answers and the
    outputs, 130 us a frame of eight bytes at most."""

    def script(robot: Robot) -> None:
        bus, doubt = robot.fieldbus, robot.image.axes["doubt_ns"]
        bus.collect(0)
        robot.put_all()
        bus.collect(1)
        heartbeat_us = 55  # the last of the bring-up may just have been sent
        assert (doubt <= heartbeat_us * 1000).all()
        bus.publish(1)
        robot.put_all()
        bus.collect(2)
        frames_us = heartbeat_us + 47 + 5 * 111  # SYNC, and at most five answers
        assert (doubt > heartbeat_us * 1000).all()
        assert (doubt <= frames_us * 1000).all()
        robot.put_all()
        before = doubt.copy()
        bus.collect(3)
        assert (doubt > before).all()

    run(script)


def test_ages_count_ticks_and_a_stale_drive_is_lost() -> None:
    def script(robot: Robot) -> None:
        bus, image = robot.fieldbus, robot.image
        bus.collect(0)
        robot.put_all()
        bus.collect(1)
        for tick in range(2, 7):
            for axis in range(1, 8):
                robot.put_axis(axis)
            bus.collect(tick)
            assert image.axes["age"][0] == tick - 1
            assert image.cells["age"][0] == tick - 1
            assert image.axes["age"][1] == 0
            lost = image.axes["state"][0] == AxisState.LOST
            assert lost == (tick - 1 > robot.config.control.freshness.measurement_ticks)
        # Ticks that were skipped age a sample too.
        for axis in range(1, 8):
            robot.put_axis(axis)
        bus.collect(12)
        assert image.axes["age"][1] == 12 - 6 - 1

    run(script)


def test_irregular_frames_are_told_apart_and_harm_nothing() -> None:
    def script(robot: Robot) -> None:
        bus, image = robot.fieldbus, robot.image
        bus.collect(0)
        robot.put_all()
        bus.collect(1)
        assert names(robot) == []
        can0 = robot.buses["can0"]

        robot.put_axis(0, position=7)
        robot.put_axis(0, position=-7)
        bus.collect(2)
        assert names(robot) == ["duplicate_pdo"]
        assert image.axes["angle"][0] == pytest.approx(7 * INCREMENT)

        can0.put(0x181, b"\x37\x16\x01")
        can0.put(0x191, bytes(5))
        bus.collect(3)
        assert names(robot) == ["short_pdo", "long_pdo"]
        assert [image.axes["age"][0], image.cells["age"][0]] == [1, 2]
        assert image.axes["angle"][0] == pytest.approx(7 * INCREMENT)

        robot.put_axis(0, position=8)  # the answer that was missing, then the one that is due
        robot.put_axis(0, position=9)
        bus.collect(4)
        assert names(robot) == ["missing_pdo", "late_pdo"]
        assert image.axes["angle"][0] == pytest.approx(9 * INCREMENT)
        assert image.axes["age"][0] == 1  # either may have come last
        robot.put_axis(0, position=10)
        bus.collect(5)
        assert image.axes["age"][0] == 0
        assert names(robot) == []

        can0.put(0x123, b"\x01")
        can0.put(0x181, bytes(8), is_extended_id=True)
        can0.put(0x181, bytes(8), is_remote_frame=True)
        can0.put(0x080, b"", is_error_frame=True)
        bus.collect(6)
        assert names(robot) == ["foreign_frame", "foreign_frame", "foreign_frame", "bus_error"]
        assert image.axes["age"][0] == 1

    run(script)


def test_a_flood_neither_holds_the_tick_nor_fills_the_log() -> None:
    def script(robot: Robot) -> None:
        for tick in range(300):
            for _ in range(40):
                robot.buses["can1"].put(0x7FF, b"\x00" * 8)
            robot.fieldbus.collect(tick)
        assert 1 <= names(robot).count("foreign_frame") < 20
        for _ in range(100_000):
            robot.buses["can1"].put(0x7FF, b"")
        robot.fieldbus.collect(300)
        assert len(robot.buses["can1"].inbox) > 99_000

    run(script)


def test_torque_goes_out_in_per_mille_and_only_to_an_enabled_axis() -> None:
    def script(robot: Robot) -> None:
        bus, image = robot.fieldbus, robot.image
        rated = 0.568 * 49 / 4
        image.commands["command"] = AxisCommand.ENABLE
        image.commands["torque"] = rated * np.array([0.1, -0.1, 0.0004, 0.0006, 3.0, -9e9, 0, 1])
        bus.collect(0)
        bus.publish(0)
        assert {robot.last_rpdo(axis) for axis in range(8)} == {(0x00, 0)}
        robot.put_all(0x1637, no_axis=frozenset({7}))
        robot.put_axis(7, 0x1631)
        bus.collect(1)
        bus.publish(1)
        sent = [robot.last_rpdo(axis) for axis in range(8)]
        assert [torque for _, torque in sent] == [100, -100, 0, 1, 2000, -2000, 0, 0]
        assert [word for word, _ in sent] == [0x0F] * 7 + [0x07]

    run(script)


def test_a_torque_that_is_no_number_is_zero_and_is_told_once_an_episode() -> None:
    def script(robot: Robot) -> None:
        bus, image = robot.fieldbus, robot.image
        image.commands["command"] = AxisCommand.ENABLE
        bus.collect(0)
        told = []
        for tick, torque in enumerate([1.0, np.nan, np.nan, 1.0, np.inf, -np.inf], start=1):
            robot.put_all()
            bus.collect(tick)
            image.commands["torque"] = 1.0
            image.commands["torque"][3] = torque
            bus.publish(tick)
            assert robot.last_rpdo(2)[1] == 144
            assert robot.last_rpdo(3)[1] == (144 if torque == 1.0 else 0)
            told.append(names(robot).count("non_finite_torque"))
        assert told == [0, 1, 0, 0, 1, 0]

    run(script)


def test_the_masters_heartbeat_has_its_period_and_survives_skipped_ticks() -> None:
    def script(robot: Robot) -> None:
        sent = []
        for tick in [*range(101), *range(180, 240)]:
            robot.fieldbus.collect(tick)
            robot.fieldbus.publish(tick)
            frames = robot.buses["can2"].take_sent()
            if (0x77F, b"\x05") in frames:
                sent.append(tick)
        assert sent == [*range(0, 101, 20), 180, 200, 220]

    run(script)


def test_a_missing_heartbeat_makes_the_axis_lost_until_it_is_heard_again() -> None:
    def script(robot: Robot) -> None:
        bus, image = robot.fieldbus, robot.image
        lost_at = None
        for tick in range(400):
            robot.put_all()
            if tick % 100 == 0:
                robot.put_heartbeats(without=frozenset({3}))
            bus.collect(tick)
            if lost_at is None and tick > 0 and image.axes["state"][2] == AxisState.LOST:
                lost_at = tick
        assert lost_at is not None
        # One lost frame, and the lab's jitter of 60 ms; one node is looked at a tick.
        assert 2 * 100 + 60 < lost_at <= 2 * 100 + 60 + 17 + 1
        assert image.axes["age"][2] == 0
        assert (image.axes["state"] == AxisState.LOST).sum() == 1
        events = bus.take_events()
        assert [(event.name, event.where) for event in events] == [("heartbeat_lost", "can1/3")]
        robot.put_heartbeats()
        robot.put_all()
        bus.collect(400)
        assert image.axes["state"][2] == AxisState.OPERATION_ENABLED
        assert names(robot) == ["heartbeat_back"]

    run(script)


def test_an_emergency_is_told_in_words_and_reaches_the_image() -> None:
    def script(robot: Robot) -> None:
        bus, image = robot.fieldbus, robot.image
        bus.collect(0)
        robot.buses["can0"].put(0x087, b"\x50\x82\x10\0\0\0\0\0")
        robot.buses["can0"].put(0x097, b"\x00\x50\x01\0\0\0\0\0")
        robot.buses["can0"].put(0x081, b"\x50")
        bus.collect(1)
        drive, cell, short = bus.take_events()
        assert (drive.name, drive.where) == ("emcy", "can0/7")
        assert "0x8250, register 0x10: receive PDO timeout; stops as set in 0x6007" in drive.text
        assert "hardware error" in cell.text
        assert short.name == "short_emcy"
        assert list(image.axes["error_code"][[0, 6]]) == [0, 0x8250]
        assert list(image.cells["status"][[0, 6]]) == [0, 0xFF]
        robot.buses["can0"].put(0x087, bytes(8))
        robot.buses["can0"].put(0x097, bytes(8))
        bus.collect(2)
        assert not image.axes["error_code"].any()
        assert not image.cells["status"].any()

    run(script)


@pytest.mark.parametrize("emergency_first", [True, False])
def test_a_mapped_status_does_not_take_an_emergency_of_its_cell_back(
    emergency_first: bool,
) -> None:
    config, _ = load(
        "config/can.yaml", overrides={"fieldbus.force_cell.tpdo": [0x91300120, 0x61500108]}
    )

    def script(robot: Robot) -> None:
        bus, cells, can0 = robot.fieldbus, robot.image.cells, robot.buses["can0"]
        emergency, measurement = (0x097, b"\x00\x50\x01\0\0\0\0\0"), (0x197, bytes(5))
        bus.collect(0)
        frames = [emergency, measurement] if emergency_first else [measurement, emergency]
        for frame in frames:
            can0.put(*frame)
        bus.collect(1)
        assert list(cells["status"][[0, 6]]) == [0, 0xFF]
        can0.put(*measurement)
        bus.collect(2)
        assert cells["age"][6] == 0
        assert cells["status"][6] == 0xFF
        can0.put(0x197, bytes(4) + b"\x04")
        can0.put(0x097, bytes(8))
        bus.collect(3)
        assert cells["status"][6] == 4, "the cell's own status counts again"

    run(script, Robot(config))


def test_a_node_that_restarts_while_running_is_told() -> None:
    def script(robot: Robot) -> None:
        robot.fieldbus.collect(0)
        robot.buses["can1"].put(0x705, b"\x00")
        robot.buses["can1"].put(0x705, b"\x7f")
        robot.fieldbus.collect(1)
        assert names(robot) == ["boot_up", "left_operational"]

    run(script)


def test_a_bus_that_refuses_frames_is_told_once_an_episode() -> None:
    def script(robot: Robot) -> None:
        bus = robot.fieldbus
        told = []
        for tick in range(30):
            robot.buses["can3"].refuses = 5 <= tick < 10 or tick >= 20
            bus.collect(tick)
            bus.publish(tick)
            told += [tick] * names(robot).count("transmit_refused")
        assert told == [5, 20]
        robot.buses["can3"].refuses = False

    run(script)


def test_the_tap_sees_both_ways() -> None:
    tap = Tap()
    seen = tap.seen

    def script(robot: Robot) -> None:
        seen.clear()
        robot.fieldbus.collect(0)
        robot.put_cell(2, 5)
        robot.fieldbus.collect(1)

    robot = Robot(tap=tap)
    run(script, robot)
    assert [frame[1:] for frame in seen[:4]] == [(n, 0x080, b"", True) for n in range(4)]
    assert (1, 0x180 + 19, b"\x05\0\0\0", False) in [frame[1:] for frame in seen]


def test_objects_are_read_and_written_while_ticks_run() -> None:
    async def work() -> None:
        import asyncio

        robot = Robot()
        await robot.start()

        async def ticks() -> None:
            for tick in range(20):
                robot.fieldbus.collect(tick)
                await asyncio.sleep(0.001)

        running = asyncio.create_task(ticks())
        await asyncio.sleep(0.002)
        await robot.fieldbus.sdo_write(3, 0x3001, 2, (9000).to_bytes(4, "little"))
        assert await robot.fieldbus.sdo_read(3, 0x3001, 2) == (9000).to_bytes(4, "little")
        await running
        await robot.fieldbus.stop()

    in_virtual_time(work())


def test_a_second_start_begins_anew_at_tick_zero() -> None:
    async def work() -> None:
        robot = Robot()
        for _ in range(2):
            await robot.start()
            robot.fieldbus.collect(0)
            assert set(robot.image.axes["age"]) == {NEVER}
            for tick in range(1, 10):
                robot.put_all()
                robot.fieldbus.collect(tick)
                assert set(robot.image.axes["age"]) == {0}
            await robot.fieldbus.stop()

    in_virtual_time(work())


def test_frames_are_stamped_on_our_clock_whatever_the_bus_keeps() -> None:
    tap = Tap()

    def script(robot: Robot) -> None:
        robot.fieldbus.collect(0)
        tap.seen.clear()
        for seconds in (1.7e9, 1.7e9 + 0.25, 1.7e9 + 0.2, 1.7e9 + 0.24):
            robot.buses["can0"].put(0x181, bytes(8), timestamp=seconds)
        robot.fieldbus.collect(1)
        stamps = [frame[0] for frame in tap.seen if not frame[4]]
        now = stamps[0]
        # The least delay seen so far stands for the difference of the clocks.
        assert stamps[1] == now
        assert stamps[2] == pytest.approx(now - 50_000_000, abs=1000)
        assert stamps[3] == pytest.approx(now - 10_000_000, abs=1000)

    run(script, Robot(tap=tap))
