"""The integral that PID and the bio variant with an integral share."""

from __future__ import annotations

import numpy as np

from tonus.config.schema.control import Integral as Settings
from tonus.runtime.control.controllers.base import Array, Motion, norm


class Integral:
    """Force (3,) that grows with the error and cannot wind up.

    It stands still while the stiffness is held down, gives back what the cables could not deliver
    (back-calculation over the integral's own time K / K_i), and its norm is bounded.
    """

    def __init__(self, settings: Settings, period: float) -> None:
        self._settings, self._period = settings, period
        self.value = np.zeros(3)

    def reset(self) -> None:
        self.value[:] = 0.0

    def __call__(self, motion: Motion, stiffness: float, *, held: bool) -> Array:
        """``stiffness`` (N/m) of the spring beside it; ``held`` while something caps it."""
        gain, limit = self._settings.gain, self._settings.limit
        if not held:
            back = motion.shortfall / stiffness
            self.value += self._period * gain * (motion.error - back)
            size = norm(self.value)
            if not size <= limit:
                self.value *= limit / size
        return self.value
