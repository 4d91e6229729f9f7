"""The mean that is recorded of the cables is numpy's, to the bit."""

from __future__ import annotations

import numpy as np
import pytest

from tonus.runtime.recording.record_writers import mean


@pytest.mark.parametrize("cables", range(6, 13))
def test_the_mean_is_numpys_to_the_bit(cables: int) -> None:
    draw = np.random.default_rng(cables)
    for _ in range(500):
        values = draw.normal(1.0, 10.0 ** draw.uniform(-12.0, 12.0), cables)
        assert mean(values) == values.mean()
