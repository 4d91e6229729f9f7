"""How long a classic CAN frame is on the wire, stuff bits included (ISO 11898-1).

Stuffed are start of frame to the end of the CRC; CRC delimiter, acknowledge slot and delimiter and
seven bits of end of frame follow unstuffed. The inter-frame space is the bus's, not the frame's.
"""

from __future__ import annotations

from numba import njit

INTERFRAME_BITS = 3
LONGEST_FRAME_BITS = 160
"""Extended, eight bytes, every possible stuff bit: 64 + 64 + 29, and some."""


@njit("int64(int64, int64, int64)", cache=True)
def stuffed_bits(identifier: int, dlc: int, data: int) -> int:
    """`frame_bits`, the payload as one big-endian two's complement integer (it fits 64 bits)."""
    remote = (identifier >> 30) & 1
    if identifier >> 31 & 1:
        base = (identifier >> 18) & 0x7FF
        # SOF, base identifier, SRR, IDE, 18 identifier bits, RTR, r1, r0, DLC
        head = (((base << 2 | 3) << 18 | (identifier & 0x3FFFF)) << 1 | remote) << 6 | dlc
        head_bits = 39
    else:
        # SOF, identifier, RTR, IDE, r0, DLC
        head = ((identifier & 0x7FF) << 1 | remote) << 6 | dlc
        head_bits = 19
    data_bits = 0 if remote else 8 * min(dlc, 8)
    plain = head_bits + data_bits
    crc = 0
    stuffed = 0
    run = 0
    last = -1
    for place in range(plain + 15):
        if place < head_bits:
            bit = (head >> (head_bits - 1 - place)) & 1
        elif place < plain:
            bit = (data >> (plain - 1 - place)) & 1
        else:
            bit = (crc >> (plain + 14 - place)) & 1
        if place < plain:
            feed = bit ^ (crc >> 14)
            crc = (crc << 1) & 0x7FFF
            if feed:
                crc ^= 0x4599
        if bit == last:
            run += 1
            if run == 5:
                stuffed += 1
                last = 1 - bit  # the stuff bit begins the next run
                run = 1
        else:
            last = bit
            run = 1
    return plain + 15 + stuffed + 10


def frame_bits(identifier: int, dlc: int, data: bytes) -> int:
    """Bits from start of frame to the last bit of end of frame.

    ``identifier`` carries the flags above; ``data`` holds min(dlc, 8) bytes, none if remote.
    """
    length: int = stuffed_bits(identifier, dlc, int.from_bytes(data, "big", signed=True))
    return length
