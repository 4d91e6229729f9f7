"""What an EPOS4's objects show of its motor, and in which units."""

from __future__ import annotations

from collections.abc import Callable

from tonus.sim.devices.cia402.guard import Guard
from tonus.sim.devices.cia402.servo import Servo
from tonus.sim.devices.epos4.profile_objects import ROWS
from tonus.sim.devices.objects import Kind, ObjectDictionary, Value
from tonus.sim.devices.samples import Samples
from tonus.sim.devices.timers import Timers

_SPEEDS = {
    (row[0], row[1]): (row[6], row[7])
    for row in ROWS
    if row[0] in (0x607F, 0x6080, 0x6081, 0x6099, 0x60FF)
}
"""Ranges in rpm, whatever unit 0x60A9 has."""
_LOW, _HIGH = (int(limit) for limit in Kind.I32.limits)


def scale_speeds(objects: ObjectDictionary) -> float:
    """rpm for one unit of velocity by the prefix of 0x60A9; the ranges of speeds follow it, their
    values stay the numbers they are."""
    prefix = objects.number(0x60A9, 0) >> 24
    scale = 10 ** (256 - prefix) if prefix else 1
    for key, (low, high) in _SPEEDS.items():
        entry = objects.find(*key)
        least, most = entry.kind.limits
        entry.low = max(low * scale, least) if low < 0 else low
        entry.high = min(high * scale, most)
    return 1.0 / scale


def _fits(value: float) -> int:
    return min(max(round(value), _LOW), _HIGH)


def connect(
    axis: int,
    objects: ObjectDictionary,
    samples: Samples,
    timers: Timers,
    servo: Servo,
    guard: Guard,
) -> None:
    """Let the objects of measured and computed values read them."""
    plant, number = samples.plant, objects.number

    def present() -> None:
        plant.advance(timers.now_ns)

    def position() -> int:
        return samples.at(timers.now_ns).item(axis)

    def torque() -> int:
        return samples.at(timers.now_ns).item(samples.torque + axis)

    def speed() -> int:
        present()
        return _fits(float(plant.motor_rate[axis]) / servo.velocity_unit)

    def current() -> int:
        present()
        return round(1e3 * servo.current)

    def index_position() -> int:
        """Where the last index pulse below the present position was."""
        present()
        return _fits(samples.position(axis) - servo.encoder % servo.revolution)

    def duty() -> int:
        """Per mille of the supply that the winding and its back-EMF need."""
        present()
        resistance, constant = number(0x3002, 1) * 1e-3, number(0x3001, 5) * 1e-6
        volt = resistance * servo.current + constant * float(plant.motor_rate[axis])
        return min(round(1e3 * abs(volt) / guard.supply), 1000) if guard.supply > 0.0 else 0

    def motor_level() -> int:
        guard.warm()
        return guard.motor.percent

    def stage_level() -> int:
        guard.warm()
        return guard.power_stage.percent

    reads: dict[tuple[int, int], Callable[[], Value]] = {
        (0x2200, 1): lambda: round(10.0 * guard.supply),
        (0x3000, 5): lambda: 4 * number(0x3010, 1),
        (0x3000, 6): lambda: number(0x6080, 0),
        (0x3010, 4): index_position,
        (0x30D0, 0): lambda: round(1e3 * float(plant.current_reference[axis])),
        (0x30D1, 1): current,
        (0x30D1, 2): current,
        (0x30D2, 1): torque,
        (0x30D3, 1): speed,
        (0x3200, 1): motor_level,
        (0x3200, 2): stage_level,
        (0x3201, 1): lambda: round(10.0 * guard.temperature),
        (0x3203, 1): duty,
        (0x6061, 0): lambda: number(0x6060, 0),
        (0x6062, 0): lambda: _fits(servo.position_demand),
        (0x6064, 0): position,
        (0x606B, 0): lambda: _fits(servo.speed_demand / servo.per_radian / servo.velocity_unit),
        (0x606C, 0): speed,
        (0x6076, 0): lambda: round(number(0x3001, 1) * number(0x3001, 5) / 1000),
        (0x6077, 0): torque,
        (0x60E4, 1): position,
        (0x60E5, 1): speed,
        (0x60E5, 9): speed,
        (0x60F4, 0): lambda: _fits(servo.position_demand - servo.position),
    }
    for key, read in reads.items():
        objects.find(*key).read = read
