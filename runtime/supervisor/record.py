"""What the daemon says of itself: the newest records of its ring."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.runtime.recording.ring import RingReader
from tonus.runtime.signals import cycle_dtype

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Answers:
    """What drives and amplifiers have answered, as the daemon records it."""

    angle: Floats
    """rad of the drums (n,)"""
    torque: Floats
    """N m at the drums, the drives' own figure (n,)"""
    statusword: NDArray[np.uint16]
    """(n,)"""
    age: NDArray[np.uint16]
    """ticks (n,)"""
    force: Floats
    """N of the cells, as reported (n + 1,)"""
    force_age: NDArray[np.uint16]
    """ticks (n + 1,)"""
    force_status: NDArray[np.uint8]
    """of the amplifiers, 0 good (n + 1,)"""


@dataclass(frozen=True)
class Claim:
    """One record, as far as it is judged."""

    at_ns: int
    """when its tick was due"""
    state: int
    torque: Floats
    """N m at the drums (n,)"""
    tension: Floats
    """N, tared (n,)"""
    reference: Floats
    """N (n,)"""
    tare: Floats
    """N of the cells (n + 1,)"""
    contact: float
    stiffness: float
    """N/m"""
    failed: NDArray[np.bool_]
    """cables that are given up (n,)"""
    answers: Answers | None = None
    """where they are asked for"""


Records = Callable[[], Iterable[tuple[int, Any]]]
"""New records since the last call, each with its stamp in ns."""


def of_ring(ring: RingReader, cables: int) -> Records:
    """From a ring file, beside its reader."""
    dtype = cycle_dtype(cables)

    def new() -> Iterable[tuple[int, Any]]:
        stamps, payloads = ring.drain(ring.capacity)
        return zip(stamps.tolist(), payloads.view(dtype)[:, 0], strict=True)

    return new


def claims(records: Iterable[tuple[int, Any]], *, answered: bool = False) -> list[Claim]:
    """In their order; ``answered``: with what the devices have answered."""
    return [
        Claim(
            stamp,
            int(record["state"]["state"]),
            record["drives"]["torque_command"].copy(),
            record["tension"]["measured"].copy(),
            record["tension"]["reference"].copy(),
            record["force_cells"]["tare"].copy(),
            float(record["wrench"]["contact"]),
            float(record["stiffness"]["k_eq"]),
            record["state"]["failed"].astype(bool),
            _answers(record) if answered else None,
        )
        for stamp, record in records
    ]


def _answers(record: Any) -> Answers:
    drives, cells = record["drives"], record["force_cells"]
    return Answers(
        drives["angle"].copy(),
        drives["torque"].copy(),
        drives["statusword"].copy(),
        drives["age"].copy(),
        cells["raw"].copy(),
        cells["age"].copy(),
        cells["status"].copy(),
    )
