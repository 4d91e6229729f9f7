"""The master against scripted nodes: what it tells them, and what it says when they fail."""

from __future__ import annotations

import asyncio
import struct

import can
import pytest
from fake_can import FakeNode, Robot, in_virtual_time, u32

from config import load
from drivers.canopen.master import CanopenFieldbus
from drivers.errors import BringUpError
from drivers.process_image import ProcessImage


def brought_up() -> Robot:
    robot = Robot()

    async def work() -> None:
        await robot.start()

    in_virtual_time(work())
    return robot


def failure(robot: Robot) -> str:
    async def work() -> str:
        with pytest.raises(BringUpError) as caught:
            await robot.start()
        return str(caught.value)

    text = in_virtual_time(work())
    assert "\n" not in text
    assert all(bus.closed for bus in robot.buses.values())
    return text


def number(node: FakeNode, index: int, sub: int) -> int:
    return int.from_bytes(node.objects[index, sub], "little")


def test_every_drive_is_configured_for_cyclic_synchronous_torque() -> None:
    robot = brought_up()
    for node_id in range(1, 9):
        node = robot.nodes[node_id]
        assert number(node, 0x6060, 0) == 10
        assert number(node, 0x60C2, 1) == 0
        assert number(node, 0x6071, 0) == 0
        assert [number(node, 0x3001, sub) for sub in (1, 2, 5)] == [8000, 16000, 71000]
        assert number(node, 0x3010, 1) == 1024
        assert number(node, 0x1016, 1) == 127 << 16 | 100
        assert number(node, 0x1017, 0) == 100
        assert number(node, 0x1400, 1) == 0x200 + node_id
        assert [number(node, 0x1600, sub) for sub in range(3)] == [2, 0x60400010, 0x60710010]
        assert number(node, 0x1800, 1) == 0x40000180 + node_id
        assert number(node, 0x1400, 2) == number(node, 0x1800, 2) == 1
        assert all(number(node, 0x1400 + n, 1) & 1 << 31 for n in (1, 2, 3))
    for node_id in range(17, 26):
        node = robot.nodes[node_id]
        assert number(node, 0x6132, 1) == 2
        assert [number(node, 0x1A00, sub) for sub in range(2)] == [1, 0x91300120]
    assert len([line for line in robot.progress if "configured" in line]) == 17


def test_all_failures_are_told_together_in_one_line() -> None:
    robot = Robot()
    robot.nodes[3].present = False
    robot.nodes[5].objects[0x1018, 2] = u32(0x61500000)
    robot.nodes[6].objects[0x1018, 3] = u32(0x01100000)
    robot.nodes[7].aborts[0x6060, 0] = 0x06090030
    robot.nodes[20].objects[0x6131, 1] = u32(0xFA010100)
    text = failure(robot)
    assert text.startswith("5 of 17 nodes")
    assert "can1/3 (drive of axis 2): missing: no boot-up within 2000 ms" in text
    assert "product 0x61500000, not 0x65510000" in text
    assert "firmware too old: revision 0x01100000, at least 0x01700000" in text
    assert "can3/7 (drive of axis 6): abort 0x06090030: value out of range" in text
    assert "0x6060:0" in text
    assert "can1/20 (force cell 3): 0x6131:1 (physical unit, newton)" in text
    assert "can0/1 " not in text


def test_a_mapping_that_reads_back_differently_is_refused() -> None:
    robot = Robot()
    robot.nodes[2].stuck[0x1A00, 2] = u32(0x606C0020)
    text = failure(robot)
    assert "can0/2" in text
    assert "TPDO1: 0x1A00:2 reads 0x606C0020, not 0x60640020 as written" in text


def test_rated_torque_that_differs_from_the_configuration_is_refused() -> None:
    robot = Robot()
    robot.nodes[4].objects[0x6076, 0] = u32(567_999)
    assert "rated torque, uN m) reads 567999, not 568000" in failure(robot)


def test_a_node_that_does_not_start_is_named() -> None:
    robot = Robot()
    robot.nodes[8].starts = False
    text = failure(robot)
    assert "can3/8" in text
    assert "told to start but boot-up" in text


def test_a_silent_server_times_out_and_is_told_so() -> None:
    robot = Robot()
    node = robot.nodes[1]
    answer = node.answer
    node.answer = lambda identifier, data: answer(identifier, data) if identifier == 0 else []
    assert "can0/1 (drive of axis 0): no answer within 100 ms, reading 0x1018:1" in failure(robot)
    aborts = [data for _, data in robot.buses["can0"].sent if data[:1] == b"\x80" and len(data) > 2]
    assert struct.pack("<BHBI", 0x80, 0x1018, 1, 0x05040000) in aborts


def test_a_channel_that_cannot_be_opened_is_named() -> None:
    robot = Robot()

    def refuse(name: str) -> can.BusABC:
        if name == "can2":
            raise can.CanInitializationError("no such device")
        return robot.buses[name]

    robot.fieldbus = CanopenFieldbus(load("config/can.yaml")[0], ProcessImage(), open_bus=refuse)

    async def work() -> None:
        with pytest.raises(BringUpError, match=r"can2 cannot be opened .* no such device"):
            await robot.start()

    in_virtual_time(work())
    assert robot.buses["can0"].closed
    assert robot.buses["can1"].closed


def test_stop_takes_power_and_heartbeat_watch_and_may_be_called_twice() -> None:
    robot = Robot()

    async def work() -> None:
        await robot.start()
        for tick in range(3):
            robot.fieldbus.collect(tick)
            robot.fieldbus.publish(tick)
        await robot.fieldbus.stop()
        await robot.fieldbus.stop()

    in_virtual_time(work())
    for axis in range(8):
        bus, node_id = robot.axis_at[axis]
        assert number(robot.nodes[node_id], 0x1016, 1) == 0
        frames = bus.sent
        off = max(i for i, frame in enumerate(frames) if frame == (0x200 + node_id, bytes(4)))
        assert (0x080, b"") in frames[off:]
        assert (0x000, bytes((0x80, node_id))) in frames[off:]
        assert bus.closed


def test_between_start_and_the_first_tick_the_heartbeat_goes_on() -> None:
    robot = Robot()

    async def work() -> None:
        await robot.start()
        await asyncio.sleep(1.0)
        beats = robot.buses["can0"].take_sent()
        assert beats == [(0x77F, b"\x05")] * len(beats)
        assert 19 <= len(beats) <= 21
        robot.fieldbus.collect(0)
        await asyncio.sleep(1.0)
        assert robot.buses["can0"].take_sent() == [(0x080, b"")]
        await robot.fieldbus.stop()

    in_virtual_time(work())
