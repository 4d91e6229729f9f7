"""I2t: how warm a conductor is by the current it has carried, as a share of what it bears."""

from __future__ import annotations

from math import exp


class Thermal:
    """First order: at the continuous current for ever the level ends at 1."""

    def __init__(self) -> None:
        self.level = 0.0
        self.hot = False
        """since the level reached 1 and until it has fallen below the release level"""

    def pass_current(
        self, ampere: float, continuous: float, time_constant: float, seconds: float, release: float
    ) -> None:
        """A steady current for some time; without a continuous current nothing is watched."""
        if continuous <= 0.0:
            return
        end = (ampere / continuous) ** 2
        self.level = end + (self.level - end) * exp(-seconds / time_constant)
        self.hot = self.level >= (release if self.hot else 1.0)

    @property
    def percent(self) -> int:
        """As 0x3200 shows it, up to 200."""
        return min(round(100.0 * self.level), 200)
