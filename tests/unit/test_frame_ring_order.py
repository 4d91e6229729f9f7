"""Frames go into their ring in an order that a reader in another process may rely on."""

from __future__ import annotations

import inspect

import numpy as np
from numba import njit

from tonus.drivers.fieldbus import RAW_FRAME
from tonus.runtime.recording import taps
from tonus.runtime.recording.payloads import SENT


def test_the_compiler_keeps_the_order_of_the_stores() -> None:
    """Positions away, slots filled, positions given, frames counted: a fence stands between each
    two, and in the code as it is optimised (which has some of them more than once)."""
    assert inspect.getsource(taps._record.py_func).count("    _fence()") == 3
    record = njit(taps._record.py_func)
    frames = np.zeros(3, RAW_FRAME)
    frames["identifier"], frames["dlc"], frames["data"] = 0x181, 2, 0x1234
    frames["channel"] = 0, 0, 2
    words = np.full(32, 9)
    slot, count = record(words, (8, 6, 32), 8, 100, frames, 1, SENT, 50)
    assert (slot, count) == (26, 3)
    assert words[[8, 14, 20]].tolist() == [101, 102, 103]
    head = SENT << 48 | 2 << 40 | 0x181
    assert words[[10, 16, 22]].tolist() == [head | 1 << 32, head | 1 << 32, head | 3 << 32]
    assert words[[11, 17, 23]].tolist() == [0x1234] * 3
    (code,) = record.inspect_llvm().values()
    assert code.count("fence acq_rel") >= 3
