"""The arithmetic of CAN frames, against the published figures and against frames really stuffed."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tonus.config import load
from tonus.config.busload import channel_load, frame_bits, worst_frame_bits
from tonus.config.schema.bus import CanopenBus

CRC_POLYNOMIAL = 0x4599


def canopen(name: str) -> CanopenBus:
    bus = load("config/can.yaml")[0].fieldbus
    assert isinstance(bus, CanopenBus)
    if name == "four":
        return bus
    merged = bus.channels[0].model_copy(
        update={
            "drives": tuple(d for c in bus.channels for d in c.drives),
            "force_cells": tuple(c for channel in bus.channels for c in channel.force_cells),
        }
    )
    return bus.model_copy(update={"channels": (merged,)})


@pytest.mark.parametrize(
    ("data_bytes", "nominal", "worst"),
    [(0, 47, 55), (1, 55, 65), (2, 63, 75), (4, 79, 95), (6, 95, 115), (8, 111, 135)],
)
def test_a_frame_takes_the_published_number_of_bits(
    data_bytes: int, nominal: int, worst: int
) -> None:
    assert frame_bits(data_bytes) == nominal
    assert worst_frame_bits(data_bytes) == worst


def sent_bits(identifier: int, data: bytes) -> int:
    """Bits of a frame on the wire, built and stuffed bit by bit (ISO 11898-1)."""
    text = f"0{identifier:011b}000{len(data):04b}" + "".join(f"{byte:08b}" for byte in data)
    crc = 0
    for bit in text:
        crc_next = int(bit) ^ (crc >> 14)
        crc = (crc << 1) & 0x7FFF
        if crc_next:
            crc ^= CRC_POLYNOMIAL
    text += f"{crc:015b}"
    stuffed, last, run = 0, "", 0
    for bit in text:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            stuffed += 1
            last, run = str(1 - int(bit)), 1
    return len(text) + stuffed + 1 + 2 + 7 + 3


@given(identifier=st.integers(0, 0x7FF), data=st.binary(max_size=8))
def test_no_content_takes_more_than_the_worst_case(identifier: int, data: bytes) -> None:
    taken = sent_bits(identifier, data)
    assert frame_bits(len(data)) <= taken <= worst_frame_bits(len(data))


def test_a_quarter_of_the_robot_takes_705_us_and_with_the_contact_cell_800() -> None:
    bus = canopen("four")
    loads = [channel_load(bus, channel, 1000) for channel in bus.channels]
    assert [load.cyclic_us for load in loads] == pytest.approx([705.0, 705.0, 705.0, 800.0])
    assert [load.frames for load in loads] == [7, 7, 7, 8]
    assert loads[0].cyclic_share == pytest.approx(0.705)


def test_everything_on_one_channel_takes_almost_three_cycles() -> None:
    bus = canopen("one")
    without_contact = bus.channels[0].model_copy(
        update={"force_cells": bus.channels[0].force_cells[:8]}
    )
    assert channel_load(bus, without_contact, 1000).cyclic_us == pytest.approx(2655.0)
    load = channel_load(bus, bus.channels[0], 1000)
    assert load.cyclic_us == pytest.approx(2750.0)
    assert load.frames == 26
    assert channel_load(bus, bus.channels[0], 4000).share == pytest.approx(0.6875, abs=0.02)


def test_heartbeats_count_with_their_mean_share() -> None:
    """Four devices each 100 ms and the master each 20 ms, of 65 bits: 5.85 us a millisecond."""
    bus = canopen("four")
    assert channel_load(bus, bus.channels[0], 1000).heartbeat_us == pytest.approx(5.85)
    assert channel_load(bus, bus.channels[0], 4000).heartbeat_us == pytest.approx(23.4)


def test_the_bit_rate_and_the_mapping_decide() -> None:
    bus = canopen("four")
    slow = bus.model_copy(update={"bitrate": 500_000})
    assert channel_load(slow, slow.channels[0], 1000).cyclic_us == pytest.approx(1410.0)
    lean = bus.drive.model_copy(update={"rpdo": (0x60710010,), "tpdo": (0x60410010, 0x60640020)})
    leaner = bus.model_copy(update={"drive": lean})
    assert channel_load(leaner, leaner.channels[0], 1000).cyclic_us == pytest.approx(
        55 + 2 * 75 + 2 * 115 + 2 * 95
    )
    odd = bus.drive.model_copy(update={"rpdo": (0x60400010, 0x60600001)})
    part = bus.model_copy(update={"drive": odd})
    assert channel_load(part, part.channels[0], 1000).cyclic_us == pytest.approx(
        705 + 2 * (worst_frame_bits(3) - worst_frame_bits(4))
    )
