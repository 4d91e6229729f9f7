"""How long a classic CAN frame is on the wire, stuff bits included (ISO 11898-1).

Stuffed are start of frame to the end of the CRC; CRC delimiter, acknowledge slot and delimiter and
seven bits of end of frame follow unstuffed. The inter-frame space is the bus's, not the frame's.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

INTERFRAME_BITS = 3
LONGEST_FRAME_BITS = 160
"""Extended, eight bytes, every possible stuff bit: 64 + 64 + 29, and some."""


_START = 8
"""Before the first bit; the other states have the last bit, 4 times, and how many more equal ones
stand before it, at most 3."""
_POLYNOMIAL = 0x4599


def _next(state: int, bit: int) -> tuple[int, int]:
    """State behind a bit, and how many stuff bits it brings. Behind five equal ones the stuff bit
    begins the next run."""
    last, run = (-1, 0) if state == _START else (state // 4, state % 4 + 1)
    run = run + 1 if bit == last else 1
    return (4 * (1 - bit), 1) if run == 5 else (4 * bit + run - 1, 0)


def _stuffing(width: int) -> NDArray[np.int64]:
    """Of each state and so many bits: the state behind them, and from bit 4 on their stuff bits."""
    table = np.zeros((_START + 1, 1 << width), np.int64)
    for before in range(_START + 1):
        for bits in range(1 << width):
            state, stuffed = before, 0
            for place in range(width - 1, -1, -1):
                state, more = _next(state, bits >> place & 1)
                stuffed += more
            table[before, bits] = state | stuffed << 4
    return table


def _remainders() -> NDArray[np.int64]:
    """CRC-15 of each byte."""
    table = np.zeros(256, np.int64)
    for byte in range(256):
        crc = byte << 7
        for _ in range(8):
            crc = crc << 1 ^ (_POLYNOMIAL if crc >> 14 & 1 else 0)
        table[byte] = crc & 0x7FFF
    return table


_OF_BIT, _OF_BYTE, _REMAINDERS = _stuffing(1), _stuffing(8), _remainders()


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
    size = 0 if remote else min(dlc, 8)
    crc = stuffed = 0
    state = _START
    for place in range(head_bits - 1, head_bits - 1 - head_bits % 8, -1):
        bit = head >> place & 1
        crc = (crc << 1 & 0x7FFF) ^ (_POLYNOMIAL if bit ^ crc >> 14 else 0)
        found = _OF_BIT[state, bit]
        state, stuffed = found & 0xF, stuffed + (found >> 4)
    whole = head_bits // 8
    for number in range(whole + size):
        if number < whole:
            byte = head >> 8 * (whole - 1 - number) & 0xFF
        else:
            byte = data >> 8 * (whole + size - 1 - number) & 0xFF
        crc = (crc << 8 & 0x7FFF) ^ _REMAINDERS[crc >> 7 ^ byte]
        found = _OF_BYTE[state, byte]
        state, stuffed = found & 0xF, stuffed + (found >> 4)
    for place in range(14, 7, -1):
        found = _OF_BIT[state, crc >> place & 1]
        state, stuffed = found & 0xF, stuffed + (found >> 4)
    stuffed += _OF_BYTE[state, crc & 0xFF] >> 4
    return int(head_bits + 8 * size + 15 + stuffed + 10)


def frame_bits(identifier: int, dlc: int, data: bytes) -> int:
    """Bits from start of frame to the last bit of end of frame.

    ``identifier`` carries the flags above; ``data`` holds min(dlc, 8) bytes, none if remote.
    """
    length: int = stuffed_bits(identifier, dlc, int.from_bytes(data, "big", signed=True))
    return length
