"""The master under fire: mutated, doubled, cut short, foreign, and SDO transfers that break off.

`make fuzz` plays more of it: the environment variable TONUS_FUZZ_FRAMES is the number of frames.
"""

from __future__ import annotations

import asyncio
import os
import random
import struct
from collections.abc import Coroutine
from typing import Any

import can
import numpy as np
import pytest
from unit.fake_can import FakeNode, Robot, ScriptedBus, in_virtual_time

from tonus.drivers.errors import DriverError
from tonus.drivers.events import CAPACITY, EVENTS
from tonus.drivers.process_image import NEVER, AxisCommand, AxisState

FRAMES = int(os.environ.get("TONUS_FUZZ_FRAMES", "10000"))
PER_TICK = 72
"""on each bus; less than a drain takes, so that what is put is also read"""
TICK_S = 1e-3
OBJECTS = ((0x603F, 0), (0x1018, 1), (0x1008, 0), (0x3001, 2), (0x2000, 0))


class Fuzz:
    """One robot on scripted buses, and a source of frames that could come from anywhere."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.robot = Robot()
        self.tick = 0
        self.mutating = False
        self.waiting: set[asyncio.Task[Any]] = set()
        self.told: set[str] = set()
        for node in self.robot.nodes.values():
            self._infect(node)

    def _infect(self, node: FakeNode) -> None:
        honest = node.answer

        def answer(identifier: int, data: bytes) -> list[tuple[int, bytes]]:
            replies = honest(identifier, data)
            if not self.mutating or identifier != 0x600 + node.node_id:
                return replies
            return [(number, reply) for number, sent in replies for reply in self._spoil(sent)]

        node.answer = answer  # type: ignore[method-assign]

    def _spoil(self, reply: bytes) -> list[bytes]:
        """An SDO answer as it is, not at all, twice, damaged, or as part of a long transfer."""
        draw = self.random
        fate = draw.random()
        if fate < 0.4:
            return [reply]
        if fate < 0.5:
            return []
        if fate < 0.6:
            return [reply, reply]
        if fate < 0.7:
            return [reply[: draw.randrange(8)]]
        if fate < 0.85:  # a segmented upload that may never end
            return [struct.pack("<B3sI", 0x41, reply[1:4], draw.choice([0, 5, 20, 2**32 - 1]))]
        return [bytes((draw.choice([0x00, 0x10, 0x01, 0x20, 0x30]),)) + draw.randbytes(7)]

    def frame(self, bus: ScriptedBus) -> can.Message:
        """Something like the traffic of a bus, or not."""
        draw = self.random
        node = draw.choice(bus.nodes).node_id
        kind = draw.randrange(8)
        data = draw.randbytes(draw.choice([0, 1, 2, 7, 8, 8]))
        flags = {}
        if kind < 3:
            identifier = 0x180 + node
            size = 8 if node < 17 else 4
            data = draw.randbytes(size if draw.random() < 0.8 else draw.randrange(9))
        elif kind == 3:
            identifier = 0x580 + node
            if draw.random() < 0.5:
                index, sub = draw.choice(OBJECTS)
                command = draw.choice([0x43, 0x4F, 0x41, 0x60, 0x80, 0x00, 0x10, 0x01, 0x20])
                data = struct.pack("<BHBI", command, index, sub, draw.getrandbits(32))
        elif kind == 4:
            identifier = 0x700 + node
            data = draw.choice([b"\x00", b"\x04", b"\x05", b"\x7f", b"\x85", b"\x03", b"", data])
        elif kind == 5:
            identifier = 0x080 + node
        else:
            identifier = draw.getrandbits(11)
            flag = draw.choice(["is_extended_id", "is_remote_frame", "is_error_frame", ""])
            if flag:
                flags[flag] = True
            if flag in ("is_extended_id", "is_error_frame"):
                identifier = draw.getrandbits(29)
        flags = {"is_extended_id": identifier > 0x7FF, **flags}
        now = asyncio.get_running_loop().time()
        stamp = draw.choice([0.0, now, now - 0.5e-3, now - 5e-3, now + 1.0, -1.0, 1.7e9])
        return can.Message(timestamp=stamp, arbitration_id=identifier, data=data, **flags)

    async def play(self, frames: int) -> None:
        """Ticks with ``frames`` bad frames among good ones, while transfers and recoveries run."""
        draw, buses = self.random, list(self.robot.buses.values())
        self.mutating = True
        recovery: asyncio.Task[Any] | None = None
        while frames > 0:
            if draw.random() < 0.8:
                self.robot.put_all()
            for bus in buses:
                count = draw.randrange(PER_TICK)
                frames -= count
                bad = [self.frame(bus) for _ in range(count)]
                mixed = [*bus.inbox, *bad]
                if draw.random() < 0.2:
                    draw.shuffle(mixed)
                bus.inbox.clear()
                bus.inbox.extend(mixed)
            if draw.random() < 0.05:
                index, sub = draw.choice(OBJECTS)
                self._run(self.robot.fieldbus.sdo_read(draw.randrange(8), index, sub))
            if draw.random() < 0.01:
                self._run(self.robot.fieldbus.sdo_write(3, 0x2000, 0, draw.randbytes(30)))
            if draw.random() < 0.01 and (recovery is None or recovery.done()):
                recovery = self._run(self.robot.fieldbus.recover())
            await self.one(check=self.tick % 8 == 0)
        self.mutating = False

    def _run(self, work: Coroutine[Any, Any, Any]) -> asyncio.Task[Any]:
        task = asyncio.create_task(work)
        self.waiting.add(task)
        return task

    async def one(self, *, check: bool) -> None:
        fieldbus, commands = self.robot.fieldbus, self.robot.image.commands
        fieldbus.collect(self.tick)
        if check:
            self._check()
        commands["command"] = AxisCommand.ENABLE
        commands["torque"] = 0.5
        fieldbus.publish(self.tick)
        self.tick += 1
        await asyncio.sleep(TICK_S)
        done = {task for task in self.waiting if task.done()}
        self.waiting -= done
        for task in done:
            error = task.exception()
            assert error is None or isinstance(error, DriverError), repr(error)

    def _check(self) -> None:
        """What must hold whatever has come."""
        robot = self.robot
        image, fieldbus = robot.image, robot.fieldbus
        assert np.isfinite(image.axes["angle"]).all()
        assert np.isfinite(image.axes["torque"]).all()
        assert np.isfinite(image.cells["force"]).all()
        fresh = robot.config.control.freshness.measurement_ticks
        stale = image.axes["age"] > fresh
        assert (image.axes["state"][stale] == AxisState.LOST).all()
        assert (image.axes["age"] <= NEVER).all()
        events = fieldbus.take_events()
        assert len(events) <= CAPACITY + 1
        self.told |= {event.name for event in events}
        # Whatever comes, what is remembered of it has an end.
        assert len(fieldbus._events._counts) <= CAPACITY + len(EVENTS)
        assert len(fieldbus._events._episodes) <= CAPACITY
        for bus in robot.buses.values():
            for identifier, data in bus.take_sent():
                if 0x201 <= identifier <= 0x208:
                    _, torque = struct.unpack("<Hh", data)
                    assert abs(torque) <= 2000

    async def settle(self) -> None:
        """The storm is over: every node answers again, and the master with it."""
        robot = self.robot
        master = robot.config.fieldbus.master
        for task in self.waiting:
            task.cancel()
        await asyncio.gather(*self.waiting, return_exceptions=True)
        self.waiting.clear()
        for bus in robot.buses.values():
            bus.inbox.clear()
        await self._calm(2 * master.late_ticks)
        recovery = asyncio.create_task(robot.fieldbus.recover())
        while not recovery.done():
            await self._calm(1)
        recovery.result()
        robot.put_heartbeats()
        for bus in robot.buses.values():
            for node in bus.nodes:
                bus.put(0x080 + node.node_id, bytes(8))
        await self._calm(2 * (master.late_ticks + master.settle_ticks))
        assert set(robot.image.axes["age"]) == set(robot.image.cells["age"]) == {0}
        assert set(robot.image.axes["state"]) == {AxisState.OPERATION_ENABLED}
        assert not robot.image.cells["status"].any()
        assert {robot.last_rpdo(axis)[0] for axis in range(8)} == {0x0F}
        reading = asyncio.create_task(robot.fieldbus.sdo_read(5, 0x1018, 1))
        while not reading.done():
            await self._calm(1)
        assert reading.result() == b"\xfb\0\0\0"

    async def _calm(self, ticks: int) -> None:
        for _ in range(ticks):
            self.robot.put_all()
            await self.one(check=False)


def fuzz_master(seed: int, frames: int) -> set[str]:
    """``frames`` frames at a master in operation; it stands, and answers when they end.

    Returns the names of the events it told. Raises AssertionError, with the seed and the tick, for
    anything else.
    """
    print(f"fuzz_master: seed {seed}, {frames} frames")

    async def work() -> set[str]:
        fuzz = Fuzz(seed)
        await fuzz.robot.start()
        try:
            await fuzz.play(frames)
            await fuzz.settle()
        except Exception as error:
            raise AssertionError(f"seed {seed}, tick {fuzz.tick}: {error!r}") from error
        finally:
            fuzz.mutating = False
            await fuzz.robot.fieldbus.stop()
        return fuzz.told

    return in_virtual_time(work())


@pytest.mark.parametrize("seed", range(2))
def test_the_master_stands_whatever_frames_come(seed: int) -> None:
    told = fuzz_master(seed, FRAMES // 2)
    assert told <= set(EVENTS)
    # It was a storm that somebody looked at.
    assert told >= {
        "boot_up",
        "bus_error",
        "bus_off",
        "duplicate_pdo",
        "emcy",
        "foreign_frame",
        "late_pdo",
        "left_operational",
        "long_pdo",
        "short_emcy",
        "short_pdo",
    }
