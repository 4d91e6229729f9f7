"""Whether holding brakes hold: a drum whose drive is disabled, and whose brake has closed, stands
still whatever pulls at its cable. Only a brake under load can be judged so (docs/sto.md)."""

from __future__ import annotations

from collections.abc import Iterator

from tonus.config.schema.root import Config
from tonus.drivers.process_image import AxisState, ProcessImage

OFF = frozenset(
    {
        AxisState.SWITCH_ON_DISABLED,
        AxisState.READY_TO_SWITCH_ON,
        AxisState.SWITCHED_ON,
        AxisState.FAULT,
    }
)
"""states of a drive without power on its motor, so with its brake closed"""


class BrakeWatch:
    """`look` every tick; it does nothing where no axis has a brake."""

    def __init__(self, config: Config) -> None:
        self._most = config.operation.self_test.brake_slip
        self._fresh = config.control.freshness.measurement_ticks
        period = config.control.rates.period
        self._axes = [
            # Twice the brake's own time: its drive holds the motor for as long before.
            (axis, 1 + round(2e-3 * train.brake.closing_ms / period), train.drum.radius)
            for axis, train in enumerate(config.robot.drive_trains)
            if train.brake is not None
        ]
        self._seen: dict[int, tuple[int, int, float | None]] = {}
        """by axis: its state, since which tick, and the drum's angle (rad) once its brake holds"""
        self.slipped: dict[int, float] = {}
        """m of cable by axis, of each brake that has not held since the daemon began"""

    @property
    def fitted(self) -> bool:
        return bool(self._axes)

    def look(self, image: ProcessImage, tick: int) -> Iterator[tuple[int, float]]:
        """Axis and m of cable of each brake that is found not to hold, once each."""
        for axis, closing, radius in self._axes:
            state, angle = int(image.axes["state"][axis]), float(image.axes["angle"][axis])
            if state not in OFF or image.axes["age"][axis] > self._fresh:
                self._seen.pop(axis, None)
                continue
            # Another state begins anew: resetting some faults sets the drive's position to zero.
            before, since, held = self._seen.get(axis, (state, tick, None))
            if before != state:
                since, held = tick, None
            if held is None and tick - since >= closing:
                held = angle
            self._seen[axis] = state, since, held
            slip = 0.0 if held is None else abs(angle - held) * radius
            if slip > self._most:
                if axis not in self.slipped:
                    yield axis, slip
                self.slipped[axis] = max(slip, self.slipped.get(axis, 0.0))
