"""What must be in order before drives may be enabled, looked at while they are disabled.

It judges what the cycle read in the last tick. Referencing, which needs tension on the cables, is
judged by the cycle itself, between arming and the first motion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from tonus.config.schema.root import Config
from tonus.drivers.process_image import AxisState, ProcessImage
from tonus.runtime.control.referencing import turn_deg
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.operation.brakes import BrakeWatch
from tonus.runtime.words import axis_name, cell_name

_DISABLED = (
    int(AxisState.SWITCH_ON_DISABLED),
    int(AxisState.READY_TO_SWITCH_ON),
    int(AxisState.SWITCHED_ON),
)


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at."""

    item: str
    ok: bool
    text: str


class SelfTest:
    """`look` now and then; `obstacles` says what stands against arming."""

    def __init__(self, config: Config, brakes: BrakeWatch) -> None:
        self._config = config
        self._brakes = brakes
        self._settings = config.operation.self_test
        period = config.control.rates.period
        self.interval = max(1, round(self._settings.interval_ms * 1e-3 / period))
        """ticks between two looks"""
        self._oldest = max(self.interval, round(self._settings.maximum_age_ms * 1e-3 / period))
        self._fresh = config.control.freshness.measurement_ticks
        self._tick: int | None = None
        self.findings: tuple[Finding, ...] = ()
        """of the last look"""

    def look(self, image: ProcessImage, cycle: ControlCycle, tick: int) -> None:
        """Judge the image that the cycle was given in ``tick``."""
        self._tick = tick
        self.findings = (
            _judged("drives", "answer and are disabled", self._drives(image)),
            _judged("cells", "answer and are well", self._cells(image)),
            _judged("tare", self._tared(cycle), self._tare(cycle)),
            _judged("tensions", "all cables are slack", self._tensions(cycle)),
            *self._brake_findings(),
            _judged("tracker", "sees the platform in its cradle", self._tracker(image)),
            *(Finding(item, ok=False, text=text) for item, text in image.obstacles.items()),
        )

    def forget(self) -> None:
        """What was seen before the robot was armed says nothing about it afterwards."""
        self._tick, self.findings = None, ()

    def age(self, tick: int) -> int | None:
        """Ticks since the last look; None before any."""
        return None if self._tick is None else tick - self._tick

    def obstacles(self, tick: int) -> list[str]:
        """Why the robot may not be armed in ``tick``; empty when it may."""
        age = self.age(tick)
        if age is None:
            return ["self-test: has not run yet"]
        if age > self._oldest:
            return [f"self-test: is {age} ticks old, {self._oldest} at most are fresh"]
        return [f"{found.item}: {found.text}" for found in self.findings if not found.ok]

    def _drives(self, image: ProcessImage) -> Iterator[str]:
        ages, states = image.axes["age"].tolist(), image.axes["state"].tolist()
        for axis, (age, state) in enumerate(zip(ages, states, strict=True)):
            if age > self._fresh:
                yield f"{axis_name(self._config, axis)} does not answer"
            elif state not in _DISABLED:
                error = int(image.axes["error_code"][axis])
                said = f"{AxisState(state).name}{f', error 0x{error:04X}' if error else ''}"
                yield f"{axis_name(self._config, axis)} is in {said}"

    def _brake_findings(self) -> Iterator[Finding]:
        """None for a robot without brakes."""
        if self._brakes.fitted:
            yield _judged("brakes", "none was seen to slip", self._slipped())

    def _slipped(self) -> Iterator[str]:
        for axis, slip in sorted(self._brakes.slipped.items()):
            name = axis_name(self._config, axis)
            yield f"the brake of {name} let its cable go by {1e3 * slip:.0f} mm; repair it"

    def _cells(self, image: ProcessImage) -> Iterator[str]:
        ages, statuses = image.cells["age"].tolist(), image.cells["status"].tolist()
        for cell, (age, status) in enumerate(zip(ages, statuses, strict=True)):
            if age > self._fresh:
                yield f"{cell_name(self._config, cell)} does not answer"
            elif status:
                yield f"{cell_name(self._config, cell)} reports status {status}"

    def _tared(self, cycle: ControlCycle) -> str:
        offsets = cycle.tare.tolist()
        kind = "offsets" if self._config.control.sequence.tare is None else "stated offsets"
        return f"{kind} of {min(offsets):.2f} to {max(offsets):.2f} N are subtracted"

    def _tare(self, cycle: ControlCycle) -> Iterator[str]:
        limit = self._config.control.sequence.tare_limit
        for cell, offset in enumerate(cycle.tare.tolist()):
            if not abs(offset) <= limit:
                yield f"{cell_name(self._config, cell)} has an offset of {offset:.1f} N"

    def _tensions(self, cycle: ControlCycle) -> Iterator[str]:
        limit = self._settings.slack_tension
        for cell, force in enumerate(cycle.forces.tolist()):
            if not abs(force) <= limit:
                name = cell_name(self._config, cell)
                contact = cell == self._config.robot.contact_cell
                rest = "with nothing against it" if contact else "with its drive off"
                yield f"{name} reads {force:.1f} N {rest}"

    def _tracker(self, image: ProcessImage) -> Iterator[str]:
        seen, robot = image.tracker, self._config.robot
        delay, oldest = float(seen["delay"]), self._config.tracker.maximum_age_ms * 1e-3
        if delay == 0.0:
            # A pose is older than the datagram that brings it, so that this is none at all.
            yield "has not sent a pose yet"
        elif delay > oldest:
            yield f"its last pose is {delay:.1f} s old"
        else:
            far = math.dist(seen["position"].tolist(), robot.rest)
            if not far <= self._config.control.sequence.referencing_distance:
                yield f"sees the platform {far * 1e3:.0f} mm from its cradle; put it there"
            turn = turn_deg(seen["quaternion"])
            if not turn <= self._config.control.sequence.referencing_turn_deg:
                yield (
                    f"sees the platform askew, turned by {turn:.1f} deg; put it into the cups of "
                    "its cradle"
                )


def _judged(item: str, good: str, problems: Iterator[str]) -> Finding:
    """All that is wrong in one line, or what is right."""
    found = list(problems)
    return Finding(item, not found, "; ".join(found) or good)
