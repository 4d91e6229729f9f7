"""Independent random streams of one seed, so that a draw more in one part moves no other."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """Who draws. Append only: a number that moves changes every recorded run."""

    PLANT = 0
    CELLS = 1
    TRACKER = 2
    MISMATCH = 3
    TRACKER_ERRORS = 4
    FAULTS = 5
    SEGMENT = 6


def generator(seed: int, stream: Stream) -> np.random.Generator:
    """The generator of one stream, equal for equal seeds on every machine."""
    child = np.random.SeedSequence(seed).spawn(len(Stream))[stream]
    return np.random.Generator(np.random.PCG64(child))
