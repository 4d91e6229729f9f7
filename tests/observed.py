"""Drums shown to their observer, with samples that came on time."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.drivers.process_image import ProcessImage
from tonus.runtime.safety.drum_observer import DrumObserver

Array = NDArray[np.float64]


def observe(
    drums: DrumObserver,
    angle: Array,
    rate: Array,
    torque: Array,
    tension: Array,
    following: Array,
    watched: NDArray[np.bool_],
    interval: Array,
) -> None:
    """One tick; ``following`` (n,) rad/s, the rates at which drums would follow the platform."""
    image = ProcessImage(len(angle))
    image.axes["age"] = 0
    sensing: Any = SimpleNamespace(
        drums=np.array([angle, rate, interval]), tension=tension, usable=watched
    )
    failed = np.zeros(len(angle), dtype=bool)
    drums.step(image, sensing, failed, torque, following, skipped=False, enabled=True)
