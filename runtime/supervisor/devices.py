"""Which devices have booted, and which drives have power, also those that are silent."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tonus.runtime.states import ARMED
from tonus.runtime.supervisor.listener import Heard
from tonus.runtime.supervisor.observation import Listened, Observation
from tonus.runtime.supervisor.wiring import Axis

Key = tuple[str, int]
"""Channel and identifier of a device's heartbeat."""
_BOOT_UP = 0
"""of a heartbeat"""


class Boots:
    """`note` once a look."""

    def __init__(self, beats: dict[Key, Heard], errors: dict[Key, Heard]) -> None:
        """Heartbeats, and the emergency frames of amplifiers."""
        self._beats, self._errors = beats, errors
        self.found: set[Key] = set()
        """those with which a device has booted since the look before"""

    @property
    def devices(self) -> set[Key]:
        """All of them."""
        return {*self._beats}

    def note(self) -> None:
        """An amplifier that boots takes nothing back, and has the errors that it reports anew."""
        self.found = {key for key, beats in self._beats.items() if _BOOT_UP in beats.numbers}
        for beats in self._beats.values():
            beats.numbers.clear()
        for key in self.found & self._errors.keys():
            self._errors[key].word = 0


class Powered:
    """A silent drive counts as what it was, while the daemon's record is armed or the drive sends
    heartbeats and has not booted since."""

    def __init__(
        self, axes: Sequence[Axis], heard: Listened, boots: Boots, stale_ms: float
    ) -> None:
        self._axes, self._heard, self._boots = axes, heard, boots
        self._stale_ms = stale_ms
        self._booted = np.zeros(len(axes), bool)
        """drives that have booted since their last measurement, and were told no power since"""
        self.led = np.zeros(len(axes), bool)
        """drives that were told beside their process data to have power, until they answer that
        they are off"""
        self._led_before = self.led.copy()
        """which were so in the look before"""
        self.lost = self.led.copy()
        """drives that do not count any more, and had power when they answered last"""

    def settle(self, seen: Observation, led: Sequence[int], looked_ns: int) -> None:
        """Put into ``seen.enabled`` what counts. ``led``: axes that since the look before, at
        ``looked_ns``, were told so."""
        # A drive that is silent is what it was, unless daemon and all others are disarmed and it
        # sends no heartbeat either: then it was pulled, or has no power.
        had_power = seen.enabled.copy()
        present = seen.measured_age < self._stale_ms
        state = None if seen.claim is None else seen.claim.state
        seen.enabled &= present | self._alive(seen) | (not present.any()) | (state in ARMED)
        if state not in ARMED:
            seen.enabled &= ~self._booted
            self.led &= ~self._booted
        self.lost = had_power & ~seen.enabled
        # Nobody in order tells a drive to have power that was pulled.
        seen.enabled |= seen.told
        newly = np.isin(seen.axes, led)
        newly |= seen.told
        self._booted &= ~newly
        self.led |= newly
        # What is answered in that look, or in the next one, may be of before it acted.
        unanswered = seen.measured_age * 1e6 >= seen.now_ns - looked_ns
        self.led &= seen.enabled | unanswered | newly | self._led_before
        self._led_before = newly

    def _alive(self, seen: Observation) -> NDArray[np.bool_]:
        """Drives that go on sending heartbeats after their last measurement, and have not booted
        since: whether they still have a torque nothing says."""
        found = np.zeros(len(self._axes), bool)
        for row, axis in enumerate(self._axes):
            if not axis.heartbeat:
                continue
            beats = self._heard[axis.channel, axis.heartbeat]
            self._booted[row] |= (axis.channel, axis.heartbeat) in self._boots.found
            later_ms = seen.measured_age[row] - (seen.now_ns - beats.at_ns) * 1e-6
            found[row] = later_ms >= self._stale_ms
        self._booted &= seen.measured_age > 0.0
        return found & ~self._booted
