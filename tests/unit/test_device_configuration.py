"""Settings, mappings and events: what is written, what is refused, how often a thing is told."""

from __future__ import annotations

import asyncio
import struct

import numpy as np
import pytest

from tonus.config import load
from tonus.drivers.canopen.process_data import cell_fields, drive_encoder, drive_fields
from tonus.drivers.canopen.reception import Reception
from tonus.drivers.canopen.syncs import word_of
from tonus.drivers.cia301.pdo import Direction, Mapping, PdoError, configure, silence
from tonus.drivers.cia301.setting import Kind, Setting, SettingError, apply
from tonus.drivers.devices import force_cell
from tonus.drivers.devices.drive import Scale, settings
from tonus.drivers.errors import SdoAbortError
from tonus.drivers.events import CAPACITY, EventLog
from tonus.drivers.exchange import Exchange
from tonus.drivers.fieldbus import RAW_FRAME
from tonus.drivers.process_image import ProcessImage

CONFIG = load("config/can.yaml")[0]


class Objects:
    def __init__(self, held: dict[tuple[int, int], bytes] | None = None) -> None:
        self.held = held or {}
        self.written: list[tuple[int, int, bytes]] = []

    async def read(self, index: int, subindex: int) -> bytes:
        if (index, subindex) not in self.held:
            raise SdoAbortError(0x06020000, "object does not exist")
        return self.held[index, subindex]

    async def write(self, index: int, subindex: int, data: bytes) -> None:
        self.written.append((index, subindex, data))
        self.held[index, subindex] = data


class Deaf(Objects):
    async def write(self, index: int, subindex: int, data: bytes) -> None: ...


def test_a_value_that_is_right_already_is_not_written() -> None:
    objects = Objects({(0x3010, 1): b"\0\4\0\0", (0x6007, 0): b"\0\0"})
    settings = [
        Setting(0x6040, 0, 0, 2, "", Kind.COMMAND),
        Setting(0x3010, 1, 1024, 4, ""),
        Setting(0x6007, 0, -1, 2, ""),
    ]
    asyncio.run(apply(objects, settings))
    assert objects.written == [(0x6040, 0, b"\0\0"), (0x6007, 0, b"\xff\xff")]


def test_a_value_that_does_not_stay_and_one_of_another_size_are_refused() -> None:
    setting = Setting(0x6007, 0, 3, 2, "quick stop")
    with pytest.raises(SettingError, match=r"0x6007:0 \(quick stop\) reads 1, not 3"):
        asyncio.run(apply(Deaf({(0x6007, 0): b"\1\0"}), [setting]))
    with pytest.raises(SettingError, match="1 bytes instead of 2"):
        asyncio.run(apply(Deaf({(0x6007, 0): b"\3"}), [setting]))


def test_a_drive_is_powered_off_first_and_its_target_cleared_before_its_mode() -> None:
    train = CONFIG.robot.drive_trains[0]
    objects = [setting.index for setting in settings(train, CONFIG.fieldbus.drive)]
    assert objects[0] == 0x6040
    assert max(objects.index(0x6071), objects.index(0x60B2)) < objects.index(0x6060)
    assert objects.index(0x3001) < objects.index(0x6076)


def test_scale_of_the_papers_drive() -> None:
    scale = Scale.of(CONFIG.robot.drive_trains[0])
    assert scale.newton_metre_per_mille == pytest.approx(0.568e-3 * 49 / 4)
    assert scale.radian_per_increment * 4096 * 49 / 4 == pytest.approx(6.283185307179586)
    assert scale.mille_limit == 2000


def test_a_pdo_is_invalid_while_it_is_mapped() -> None:
    objects = Objects()
    asyncio.run(configure(objects, Direction.TPDO, 1, 3, [0x60410010, 0x60640020]))
    order = [(index, sub, int.from_bytes(data, "little")) for index, sub, data in objects.written]
    assert order == [
        (0x1800, 1, 0xC0000183),
        (0x1A00, 0, 0),
        (0x1A00, 1, 0x60410010),
        (0x1A00, 2, 0x60640020),
        (0x1A00, 0, 2),
        (0x1800, 2, 1),
        (0x1800, 1, 0x40000183),
    ]


def test_unused_pdos_are_switched_off_where_they_exist() -> None:
    objects = Objects({(0x1401, 1): (0x303).to_bytes(4, "little")})
    for number in (2, 3):
        asyncio.run(silence(objects, Direction.RPDO, number))
    assert objects.written == [(0x1401, 1, (0x80000303).to_bytes(4, "little"))]


def test_mappings_in_any_order_and_form_mean_the_same() -> None:
    encode = drive_encoder(Mapping.of([0x60710010, 0x60600008, 0x60400010]))
    assert encode(0x0F, -3) == struct.pack("<hbH", -3, 10, 0x0F)
    cell = CONFIG.fieldbus.force_cell.model_copy(update={"tpdo": (0x61500108, 0x61300120)})
    image, events = ProcessImage(8), EventLog()
    exchange = Exchange(CONFIG.robot, cell, CONFIG.control.freshness, image, events, [""] * 8)
    reception = Reception(1, 8)
    of_cell = Mapping.of(cell.tpdo)
    of_drive = Mapping.of([0x60770010, 0x60640020, 0x60410010])
    reception.add(0, 0x191, 5, cell_fields(of_cell, (4,), exchange), exchange)
    reception.add(0, 0x183, 8, drive_fields(of_drive, 2, exchange), exchange)
    reception.syncs[0].sent(0, 0)
    sent = (
        (0x191, struct.pack("<Bf", 3, -12.5)),
        (0x183, struct.pack("<hiH", -500, -50_176, 0x1637)),
    )
    frames = np.array([(5, each, len(d), 0, 0, word_of(d)) for each, d in sent], RAW_FRAME)
    assert reception(frames, 0, 9) == 2
    assert reception.syncs[0].stamp_ns == 5
    exchange.fill(1)
    assert (image.cells["force"][4], image.cells["status"][4]) == (-12.5, 3)
    assert image.axes["angle"][2] == pytest.approx(-6.283185307179586)
    assert image.axes["torque"][2] == pytest.approx(-0.5 * 0.568 * 49 / 4)
    assert force_cell.divisor(CONFIG.fieldbus.force_cell) == 100.0


@pytest.mark.parametrize(
    ("entries", "why"),
    [
        ([0x60400010], "does not map 0x6071:0"),
        ([0x60400010, 0x60710010, 0x60FF0020], "0x60FF0020, which control does not command"),
        ([0x60400010, 0x60710018], "24 bits"),
    ],
)
def test_a_mapping_that_control_cannot_work_with_is_refused(entries: list[int], why: str) -> None:
    with pytest.raises(PdoError, match=why):
        drive_encoder(Mapping.of(entries))


def test_events_stay_bounded_and_nothing_new_is_hidden_by_old_noise() -> None:
    events = EventLog()
    for number in range(10_000):
        events.counted("foreign_frame", f"can0/{number}", "")
        events.counted("foreign_frame", "can0/0", "")
    taken = events.take()
    assert len(taken) == CAPACITY + 1
    assert taken[-1].name == "dropped"
    events.begin("transmit_refused", "can0", "full")
    events.begin("transmit_refused", "can0", "full")
    assert [event.name for event in events.take()] == ["transmit_refused"]
