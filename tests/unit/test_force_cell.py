"""The emulated amplifier: its forms of a force, its autozero, its broken bridges, its channels."""

from __future__ import annotations

import struct

import can
import pytest
from lab_bench import MS
from pydantic import ValidationError

from tonus.config import load
from tonus.config.schema.bus import CellNode
from tonus.config.schema.faults import CellBreak
from tonus.config.schema.lab import LabScript
from tonus.config.schema.root import Config
from tonus.sim.devices.objects import AbortError
from tonus.sim.lab.engine import Lab

ZERO = 0x6F72657A
BUSY, DONE, FAILED = 0x75, 0x66, 0x7265
AMPLIFIER = 30


def with_an_amplifier(cells: tuple[int, ...]) -> Config:
    """The robot with these cells behind one node, on a channel of their own."""
    config = load("config/can.yaml")[0]
    bus = config.fieldbus
    assert bus.kind == "canopen"
    channels = [
        channel.model_copy(
            update={
                "force_cells": tuple(
                    n for n in channel.force_cells if not set(n.cells) & set(cells)
                )
            }
        )
        for channel in bus.channels
    ]
    node = CellNode(cells=cells, node_id=AMPLIFIER)
    channels[0] = channels[0].model_copy(update={"force_cells": (*channels[0].force_cells, node)})
    bus = bus.model_copy(update={"channels": tuple(channels)})
    return config.model_copy(update={"fieldbus": bus})


class Amplifier:
    def __init__(self, *cells: int) -> None:
        self.lab = Lab(with_an_amplifier(cells), LabScript(), seed=3, clock=lambda: self.lab.now_ns)
        self.device = next(cell for cell in self.lab.cells if cell.cells == cells)
        self.errors: list[tuple[int, int]] = []

    def write(self, index: int, sub: int, value: float) -> None:
        kind = self.device.objects.find(index, sub).kind
        self.device.objects.write(index, sub, struct.pack("<" + kind.letter, value))

    def read(self, index: int, sub: int = 1) -> float:
        kind = self.device.objects.find(index, sub).kind
        return float(struct.unpack("<" + kind.letter, self.device.objects.read(index, sub))[0])

    def wait(self, ms: float) -> None:
        self.lab.advance(self.lab.now_ns + round(ms * MS))

    def mean(self, sub: int = 1) -> float:
        """N, over 50 conversions."""
        total = 0.0
        for _ in range(50):
            self.wait(1)
            total += self.read(0x6130, sub)
        return total / 50


@pytest.fixture
def four() -> Amplifier:
    return Amplifier(0, 1, 2, 3)


def test_a_force_has_three_forms() -> None:
    cell = Amplifier(5)
    cell.lab.plant.cell_force[5] = 123.0
    for digits in (0, 2, 3):
        cell.write(0x6132, 1, digits)
        newton = cell.read(0x6130)
        assert newton == pytest.approx(123.0, abs=2.0), "offset and noise"
        assert cell.read(0x9130) == round(newton * 10**digits)
        assert cell.read(0x7130) == min(round(newton * 10**digits), 32767)
    assert cell.read(0x6131) == 0x00210000
    assert cell.read(0x6110) > 0
    assert cell.read(0x6150) == 0


def test_autozero_is_busy_for_its_time_and_takes_the_load_away() -> None:
    cell = Amplifier(4)
    before = cell.mean()
    cell.write(0x6125, 1, ZERO)
    assert cell.read(0x2004) == BUSY
    cell.wait(7.5)
    assert cell.read(0x2004) == BUSY
    with pytest.raises(AbortError, match="0x08000022"):
        cell.write(0x6125, 1, ZERO)
    cell.wait(1)
    assert cell.read(0x2004) == DONE
    # The mean of eight conversions with 0.05 N noise stays.
    assert cell.mean() == pytest.approx(0.0, abs=0.08)
    assert cell.read(0x6124) == pytest.approx(-before, abs=0.08)
    with pytest.raises(AbortError, match="0x06090030"):
        cell.write(0x6125, 1, 1)


def test_an_autozero_at_the_end_of_the_range_fails() -> None:
    cell = Amplifier(4)
    cell.device.break_sensor()
    cell.write(0x7125, 1, ZERO)
    cell.wait(9)
    assert cell.read(0x2004) == FAILED
    assert cell.read(0x6124) == 0.0


def test_a_broken_bridge_overflows_tells_and_is_mended() -> None:
    cell = Amplifier(2)
    cell.device.on_error = lambda code, register: cell.errors.append((code, register))
    fault = CellBreak(kind="cell_break", channel="can0", node=AMPLIFIER)
    cell.lab.inject(fault)
    assert cell.read(0x6150) == 3
    assert cell.read(0x6130) == 500.0
    assert cell.read(0x1001, 0) == 1
    cell.lab.inject(fault.model_copy(update={"broken": False}))
    assert cell.read(0x6150) == 0
    assert [code for code, _ in cell.errors] == [0x5010, 0]


@pytest.mark.parametrize(("force", "status"), [(700.0, 3), (-700.0, 5), (400.0, 0)])
def test_a_force_beyond_the_range_is_clipped_and_marked(force: float, status: int) -> None:
    cell = Amplifier(2)
    cell.write(0x6124, 1, -100.0)
    cell.lab.plant.cell_force[2] = force
    assert cell.read(0x6150) == status
    if status:
        assert cell.read(0x6130) == (500.0 if force > 0 else -500.0) - 100.0


def test_two_points_scale_the_bridge() -> None:
    cell = Amplifier(2)
    cell.lab.plant.cell_force[2] = 200.0
    plain = cell.read(0x6130)
    cell.write(0x6123, 1, 250.0)
    assert cell.read(0x6130) == pytest.approx(plain / 2, rel=1e-6)
    assert cell.read(0x9123) == 25000
    cell.write(0x7122, 1, 1000)
    assert cell.read(0x6122) == 1.0
    assert cell.read(0x6130) == pytest.approx(plain, rel=1e-6)
    with pytest.raises(AbortError, match="0x06040043"):
        cell.write(0x6120, 1, 1.0)
    with pytest.raises(AbortError, match="0x06090030"):
        cell.write(0x6123, 1, float("nan"))
    assert cell.read(0x6130) == pytest.approx(plain, rel=1e-6)


def test_settings_are_stored_and_restored() -> None:
    cell = Amplifier(2)
    cell.write(0x6124, 1, 5.0)
    cell.write(0x6132, 1, 3)
    cell.write(0x1010, 1, 0x65766173)
    cell.write(0x6124, 1, 6.0)
    cell.device.power_cycle()
    assert cell.read(0x6124) == 5.0
    assert cell.read(0x6132) == 3
    cell.write(0x1011, 1, 0x64616F6C)
    cell.device.reset()
    assert cell.read(0x6124) == 0.0
    assert cell.read(0x6132) == 2


def test_channels_are_cells_of_their_own(four: Amplifier) -> None:
    for cell, force in enumerate((10.0, 20.0, 30.0, 40.0)):
        four.lab.plant.cell_force[cell] = force
    four.write(0x6132, 3, 0)
    assert [four.read(0x6130, n) for n in (1, 2, 3, 4)] == pytest.approx([10, 20, 30, 40], abs=2)
    assert four.read(0x7130, 3) == pytest.approx(30, abs=2)
    assert four.read(0x7130, 4) == pytest.approx(4000, abs=200)
    four.write(0x6125, 2, ZERO)
    assert [four.read(0x2004, n) for n in (1, 2)] == [0, BUSY]
    with pytest.raises(AbortError, match="0x06090011"):
        four.read(0x6130, 5)


def test_four_channels_travel_in_one_frame(four: Amplifier) -> None:
    lab = four.lab
    lab.open()
    bus = can.Bus(interface="tonus", channel="can0")
    try:
        for data in (
            struct.pack("<BHBI", 0x23, 0x1800, 1, 0xC0000180 + AMPLIFIER),
            struct.pack("<BHBB3x", 0x2F, 0x1800, 2, 1),
            struct.pack("<BHBI", 0x23, 0x1800, 1, 0x40000180 + AMPLIFIER),
        ):
            bus.send(can.Message(arbitration_id=0x600 + AMPLIFIER, is_extended_id=False, data=data))
            four.wait(2)
        bus.send(can.Message(arbitration_id=0, is_extended_id=False, data=bytes((1, AMPLIFIER))))
        four.wait(2)
        for cell, force in enumerate((10.0, 20.0, -30.0, 40.0)):
            lab.plant.defects.offset_cell(cell, force)
        bus.send(can.Message(arbitration_id=0x80, is_extended_id=False, data=b""))
        four.wait(0.2)
        frames = []
        while (message := bus.recv(timeout=0)) is not None:
            if message.arbitration_id == 0x180 + AMPLIFIER:
                frames.append(bytes(message.data))
        assert len(frames) == 1
        values = [value / 100 for value in struct.unpack("<4h", frames[0])]
        assert values == pytest.approx([10, 20, -30, 40], abs=1.5)
    finally:
        bus.shutdown()
        lab.close()


def test_the_event_timer_sends_without_a_change() -> None:
    cell = Amplifier(6)
    lab = cell.lab
    lab.open()
    bus = can.Bus(interface="tonus", channel="can0")
    try:
        cell.write(0x6132, 1, 0)
        cell.write(0x6125, 1, ZERO)
        cell.wait(10)  # now it is zero in whole newtons, and nothing changes
        cell.write(0x1800, 5, 20)
        bus.send(can.Message(arbitration_id=0, is_extended_id=False, data=bytes((1, AMPLIFIER))))
        cell.wait(205)
        frames = []
        while (message := bus.recv(timeout=0)) is not None:
            if message.arbitration_id == 0x180 + AMPLIFIER:
                frames.append(message)
        assert 10 <= len(frames) <= 13
    finally:
        bus.shutdown()
        lab.close()


def test_no_setting_makes_a_value_that_does_not_fit_its_frame() -> None:
    cell = Amplifier(2)
    cell.lab.plant.cell_force[2] = 400.0
    cell.write(0x6132, 1, 6)
    cell.write(0x6123, 1, 1e9)
    cell.write(0x6122, 1, 1.1e-3)
    for index in (0x6130, 0x7130, 0x9130, 0x6150, 0x7123, 0x9123):
        cell.read(index)
    assert cell.read(0x9130) == 2**31 - 1


def test_one_cell_and_several_are_configured_alike() -> None:
    assert CellNode.model_validate({"cell": 3, "node_id": 1}) == CellNode(cells=(3,), node_id=1)
    for wrong in ({"cell": 3, "cells": [4]}, {"cells": []}, {"cells": [0, 1, 2, 3, 4]}, {}):
        with pytest.raises(ValidationError):
            CellNode.model_validate(wrong | {"node_id": 1})


def test_a_cell_belongs_to_one_channel_only() -> None:
    bus = with_an_amplifier((0, 1, 2, 6)).fieldbus
    given = bus.model_dump()
    assert type(bus).model_validate(given) == bus
    given["channels"][0]["force_cells"][0]["cells"] = [0, 1, 2, 2]
    with pytest.raises(ValidationError, match="cell 2 has more than one node"):
        type(bus).model_validate(given)
