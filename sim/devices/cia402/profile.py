"""The trapezoidal profile of a drive (0x6086 = 0): position and speed, moved on step by step."""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign, sqrt


@dataclass
class Trapezoid:
    """Demanded ``position`` (increments), ``speed`` (increments/s) and ``acceleration``."""

    position: float = 0.0
    speed: float = 0.0
    acceleration: float = 0.0

    def place(self, position: float, speed: float = 0.0) -> None:
        self.position, self.speed, self.acceleration = position, speed, 0.0

    def to_speed(self, wanted: float, up: float, down: float, dt: float) -> bool:
        """A step towards a speed, slowing down with ``down``; True once it has that speed."""
        slows = abs(wanted) < abs(self.speed) or wanted * self.speed < 0.0
        most = (down if slows else up) * dt
        change = min(max(wanted - self.speed, -most), most)
        self.speed += change
        self.acceleration = change / dt
        self.position += self.speed * dt
        return self.speed == wanted

    def to_position(self, target: float, top: float, up: float, down: float, dt: float) -> bool:
        """A step towards a position at no more than ``top``; True once it is there at rest."""
        gap = target - self.position
        least = down * dt
        if abs(gap) <= least * dt and abs(self.speed) <= 2.0 * least:
            self.place(target)
            return True
        # The speed from which slowing down, in whole steps, ends on the target.
        reach = least * (sqrt(0.25 + 2.0 * abs(gap) / (least * dt)) - 0.5)
        self.to_speed(copysign(min(top, reach), gap), up, down, dt)
        return False
