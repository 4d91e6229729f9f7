"""The fieldbus without frames, and that it is CAN's twin to the last bit."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import numpy as np
import pytest
from fake_can import Robot, in_virtual_time

from tonus.config import load
from tonus.drivers.direct import DirectFieldbus
from tonus.drivers.errors import BringUpError, SdoError
from tonus.drivers.process_image import AxisCommand, AxisState, ProcessImage
from tonus.runtime.timing.clock import now_ns

CONFIG = load("config/direct.yaml")[0]
PERIOD_NS = 1_000_000


class ScriptedPort:
    """Samples from a seeded table; keeps what it was given."""

    def __init__(self) -> None:
        self.calls: list[tuple[int, list[int], list[int]]] = []
        self.samples: list[tuple[list[int], list[int], list[int], list[int]]] = []
        self.objects = {(0x6076, 0): (568_000).to_bytes(4, "little")}

    def exchange(
        self, at_ns: int, controlwords: Sequence[int], torques: Sequence[int]
    ) -> tuple[list[int], list[int], list[int], list[int]]:
        self.calls.append((at_ns, list(controlwords), list(torques)))
        return self.samples[len(self.calls) - 1]

    def read(self, axis: int, index: int, subindex: int) -> bytes:
        if index == 0x2000:
            raise KeyError("no such object")
        return self.objects.get((index, subindex), b"")

    def write(self, axis: int, index: int, subindex: int, data: bytes) -> None:
        self.objects[index, subindex] = data


def samples(count: int) -> list[tuple[list[int], list[int], list[int], list[int]]]:
    random = np.random.default_rng(7)
    words = [0x1637, 0x1637, 0x1637, 0x1637, 0x1637, 0x1631, 0x1633, 0x1618]
    return [
        (
            words,
            random.integers(-(2**31), 2**31, 8).tolist(),
            random.integers(-2000, 2001, 8).tolist(),
            random.integers(-(2**31), 2**31, 9).tolist(),
        )
        for _ in range(count)
    ]


def test_the_image_is_bit_for_bit_that_of_can() -> None:
    table = samples(30)
    torques = np.random.default_rng(8).normal(0.0, 6.0, (30, 8))
    port = ScriptedPort()
    port.samples = table
    image = ProcessImage(8)
    direct = DirectFieldbus(CONFIG, image, port, now_ns)
    robot = Robot()

    async def work() -> None:
        await direct.start(lambda _: None)
        await robot.start()
        # A heartbeat of the bring-up may be on the wire: a SYNC behind it has an uncertain time.
        await asyncio.sleep(PERIOD_NS * 1e-9)
        for tick in range(30):
            direct.collect(tick)
            robot.fieldbus.collect(tick)
            assert image.axes.tobytes() == robot.image.axes.tobytes()
            assert image.cells.tobytes() == robot.image.cells.tobytes()
            for made in (image, robot.image):
                made.commands["command"] = AxisCommand.ENABLE
                made.commands["torque"] = torques[tick]
            if tick:
                # What CAN's drives hold when SYNC k comes is what the port is given in collect k.
                given = list(zip(*port.calls[tick][1:], strict=True))
                assert given == [robot.last_rpdo(axis) for axis in range(8)]
            direct.publish(tick)
            robot.fieldbus.publish(tick)
            statuswords, positions, mille, cells = table[tick]
            for axis in range(8):
                robot.put_axis(axis, statuswords[axis], positions[axis], mille[axis])
            for cell in range(9):
                robot.put_cell(cell, cells[cell])
            await asyncio.sleep(PERIOD_NS * 1e-9)
        await robot.fieldbus.stop()

    in_virtual_time(work())
    assert image.axes["state"][0] == AxisState.OPERATION_ENABLED


def test_samples_are_taken_at_the_offset_and_before_the_first_publish_nothing_moves() -> None:
    port = ScriptedPort()
    port.samples = samples(4)
    now = 0
    bus = DirectFieldbus(CONFIG, ProcessImage(8), port, lambda: now)

    async def work() -> None:
        nonlocal now
        for tick in range(3):
            now = tick * PERIOD_NS
            bus.collect(tick)
            bus.publish(tick)
        await bus.stop()

    asyncio.run(work())
    assert [at for at, _, _ in port.calls] == [50_000, 1_050_000, 2_050_000, 2_050_000]
    assert port.calls[0][1:] == port.calls[3][1:] == ([0] * 8, [0] * 8)


def test_a_drive_that_refuses_is_named() -> None:
    class Refusing(ScriptedPort):
        def write(self, axis: int, index: int, subindex: int, data: bytes) -> None:
            if (axis, index) == (5, 0x6040):
                raise ValueError("wrong state")
            super().write(axis, index, subindex, data)

    bus = DirectFieldbus(CONFIG, ProcessImage(8), Refusing(), lambda: 0)

    async def work() -> None:
        with pytest.raises(SdoError, match="0x2000:1"):
            await bus.sdo_read(0, 0x2000, 1)
        with pytest.raises(BringUpError, match=r"^1 of 8 .* axis 5: writing 0x6040:0: wrong state"):
            await bus.start(lambda _: None)

    asyncio.run(work())
