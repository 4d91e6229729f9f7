"""A frame's length against a bit-by-bit reference, and against the published figures."""

from __future__ import annotations

import random

import pytest

from tonus.sim.can.wire.frame import EXTENDED, REMOTE, arbitration_key
from tonus.sim.can.wire.timing import INTERFRAME_BITS, frame_bits


def wire(identifier: int, dlc: int, data: bytes) -> list[int]:
    """The unstuffed bits from start of frame to the CRC, by the book."""

    def bits(value: int, width: int) -> list[int]:
        return [int(digit) for digit in f"{value:0{width}b}"]

    remote = int(bool(identifier & REMOTE))
    number = identifier & 0x1FFFFFFF
    frame = [0]
    if identifier & EXTENDED:
        frame += [*bits(number >> 18, 11), 1, 1, *bits(number & 0x3FFFF, 18), remote, 0, 0]
    else:
        frame += [*bits(number, 11), remote, 0, 0]
    frame += bits(dlc, 4)
    for byte in data:
        frame += bits(byte, 8)
    # CRC by long division of the polynomial.
    rest = [*frame, *[0] * 15]
    divisor = [1, *bits(0x4599, 15)]
    for place in range(len(frame)):
        if rest[place]:
            for offset, bit in enumerate(divisor):
                rest[place + offset] ^= bit
    return frame + rest[-15:]


def length(identifier: int, dlc: int, data: bytes) -> int:
    plain = wire(identifier, dlc, data)
    sent: list[int] = []
    for bit in plain:
        sent.append(bit)
        if len(sent) >= 5 and len(set(sent[-5:])) == 1 and _run(sent) % 5 == 0:
            sent.append(1 - bit)
    return len(sent) + 1 + 2 + 7


def _run(sent: list[int]) -> int:
    count = 0
    for bit in reversed(sent):
        if bit != sent[-1]:
            break
        count += 1
    return count


def test_every_kind_of_frame_has_its_length() -> None:
    choose = random.Random(7)
    for _ in range(1500):
        flags = choose.choice([0, EXTENDED, REMOTE, EXTENDED | REMOTE])
        identifier = choose.getrandbits(29 if flags & EXTENDED else 11) | flags
        dlc = choose.randint(0, 8)
        size = 0 if flags & REMOTE else dlc
        data = bytes(choose.choice([0, 0xFF, choose.getrandbits(8)]) for _ in range(size))
        assert frame_bits(identifier, dlc, data) == length(identifier, dlc, data)


@pytest.mark.parametrize(
    ("size", "nominal", "worst"),
    [(0, 47, 55), (1, 55, 65), (2, 63, 75), (4, 79, 95), (6, 95, 115), (8, 111, 135)],
)
def test_lengths_lie_between_nominal_and_worst_case(size: int, nominal: int, worst: int) -> None:
    choose = random.Random(size)
    for _ in range(300):
        found = frame_bits(choose.getrandbits(11), size, choose.randbytes(size))
        assert nominal <= found + INTERFRAME_BITS <= worst


def test_a_known_frame() -> None:
    # Eight zero bytes: published as 126 bits with the inter-frame space, averaged over identifiers.
    found = [frame_bits(identifier, 8, bytes(8)) + 3 for identifier in range(0x180, 0x200)]
    assert abs(sum(found) / len(found) - 126) < 2


def test_arbitration_follows_the_wire() -> None:
    choose = random.Random(3)
    frames = [choose.getrandbits(11) for _ in range(40)]
    frames += [choose.getrandbits(29) | EXTENDED for _ in range(40)]
    frames += [frame | REMOTE for frame in frames]
    frames += [frame << 18 | EXTENDED for frame in frames[:10]]
    for one in frames:
        for other in frames:
            if one == other:
                continue
            # The first dominant bit decides; DLC and data come after the arbitration field.
            first, second = wire(one, 0, b""), wire(other, 0, b"")
            if arbitration_key(one) < arbitration_key(other):
                assert first < second
