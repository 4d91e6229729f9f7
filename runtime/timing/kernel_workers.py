"""Keeps the kernel's unbound workers off a processor.

They write files back to the disk, among other things. On a kernel without preemption a real-time
thread that is due meanwhile waits until one of them lets go, for a millisecond and more.
(Linux, Documentation/core-api/workqueue.rst, "cpumask".)
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

MASK = Path("/sys/devices/virtual/workqueue/cpumask")
_WORD = 8
"""hexadecimal digits between two commas of a mask"""


def keep_off(processor: int) -> Callable[[], object] | None:
    """Returns what allows them there again; None if they already were kept off. Work that has begun
    there ends there. Raises OSError if the kernel refuses, or has no other processor for them."""
    before = MASK.read_text(encoding="ascii").strip()
    allowed = int(before.replace(",", ""), 16)
    others = allowed & ~(1 << processor)
    if others == allowed:
        return None
    _write(_mask(others))
    return partial(_write, before)


def _write(mask: str) -> None:
    MASK.write_text(mask, encoding="ascii")


def _mask(processors: int) -> str:
    """As the kernel reads it: words of 32 bits."""
    digits = f"{processors:x}"
    digits = digits.zfill(-(-len(digits) // _WORD) * _WORD)
    return ",".join(digits[at : at + _WORD] for at in range(0, len(digits), _WORD))
