"""What the daemon says of itself: the newest records of its ring."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.runtime.recording.ring import RingReader
from tonus.runtime.signals import cycle_dtype
from tonus.runtime.states import State

Floats = NDArray[np.float64]
CONTROLLED = (State.REFERENCING, State.PRETENSION, State.HOLD, State.ACTIVE)


@dataclass(frozen=True)
class Answers:
    """What else drives and amplifiers have answered, as the daemon records it."""

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
    angle: Floats
    """rad of the drums (n,)"""
    answers: Answers | None = None
    """where they are asked for"""
    tick: int = 0
    fault: int = 0
    """why the robot stops, 0 for none"""
    operator: int = 0
    """order of this tick, 0 for none"""
    stop_mode: int = 0
    """how it stops"""


New = tuple[Sequence[int], NDArray[np.void]]
"""Stamps in ns and records (m,), `cycle_dtype`."""
Records = Callable[[], New]
"""New records since the last call."""


def of_ring(ring: RingReader, cables: int) -> Records:
    """From a ring file, beside its reader."""
    dtype = cycle_dtype(cables)

    def new() -> New:
        stamps, payloads = ring.drain(ring.capacity)
        return stamps.tolist(), payloads.view(dtype)[:, 0]

    return new


def claims(records: New, *, answered: bool = False) -> list[Claim]:
    """In their order; ``answered``: with what the devices have answered."""
    stamps, rows = records
    state, tension = rows["state"], rows["tension"]
    return [
        Claim(*each)
        for each in zip(
            stamps,
            state["state"].tolist(),
            rows["drives"]["torque_command"].copy(),
            tension["measured"].copy(),
            tension["reference"].copy(),
            rows["force_cells"]["tare"].copy(),
            # wrench.contact is written only where control has use for it.
            rows["force_cells"]["filtered"][:, -1].tolist(),
            rows["stiffness"]["k_eq"].tolist(),
            state["failed"].astype(bool),
            rows["drives"]["angle"].copy(),
            _answers(rows) if answered else [None] * len(stamps),
            rows["timing"]["tick"].astype(np.int64).tolist(),
            state["fault"].tolist(),
            state["operator"].tolist(),
            state["stop_mode"].tolist(),
            strict=True,
        )
    ]


def _answers(rows: NDArray[Any]) -> list[Answers]:
    drives, cells = rows["drives"], rows["force_cells"]
    return [
        Answers(*each)
        for each in zip(
            drives["torque"].copy(),
            drives["statusword"].copy(),
            drives["age"].copy(),
            cells["raw"].copy(),
            cells["age"].copy(),
            cells["status"].copy(),
            strict=True,
        )
    ]
