"""A drive in cyclic synchronous torque by its profile: what is written into it, and what its
numbers mean.

Torque: 1000 per mille of 0x6071 and 0x6077 are the motor's rated torque, gear not included.
Position: 0x6064 counts at the motor. CiA 402 (IEC 61800-7-201).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from tonus.config.schema.axis import DriveTrain
from tonus.config.schema.drive import (
    OPTION_OBJECTS,
    UNIT_OF,
    UNITS,
    DriveProfile,
    DriveSetting,
    fits,
)
from tonus.drivers.cia301.abort_codes import NO_SUCH_OBJECT
from tonus.drivers.cia301.setting import Kind, ObjectAccess, Setting
from tonus.drivers.errors import DriverError, SdoAbortError

CONTROLWORD = 0x60400010
TARGET_TORQUE = 0x60710010
STATUSWORD = 0x60410010
POSITION_ACTUAL = 0x60640020
TORQUE_ACTUAL = 0x60770010
MODES_OF_OPERATION = 0x60600008
TORQUE_OFFSET = 0x60B20010

CYCLIC_SYNCHRONOUS_TORQUE = 10
CONSTANTS = {MODES_OF_OPERATION: CYCLIC_SYNCHRONOUS_TORQUE, TORQUE_OFFSET: 0}
"""What a mapped object that control does not command carries in every RPDO."""

INT16_MAX = 0x7FFF
PER_MILLE = 1000
_ROUNDING = 1e-6
"""So that a whole number of per mille that was computed is not one less."""
RATED_CURRENT = 0x6075
GEAR_RATIO = 0x6091
_KINDS = {"write": Kind.STORE, "check": Kind.CHECK, "command": Kind.COMMAND}
_WHY = {
    "abort_connection": "when the connection is lost",
    "quick_stop": "quick stop",
    "shutdown": "shutdown",
    "disable_operation": "disable operation",
    "halt": "halt",
    "fault_reaction": "fault reaction",
}


def require_interpolation(profile: DriveProfile, key: str, period_us: int) -> None:
    """Raises `DriverError` for a 0x60C2 that is neither 0 nor the period of the tick; ``key`` is
    where the profile stands."""
    if (profile.interpolation_ms or 0) * 1000 not in (0, period_us):
        raise DriverError(
            f"{key}.interpolation_ms is {profile.interpolation_ms}; it must be 0 or the "
            f"period of {period_us} us, or {profile.name} drives see RPDOs that are missing"
        )


def settings(train: DriveTrain, profile: DriveProfile) -> tuple[Setting, ...]:
    """What the drive of a ``train`` must hold before it is started, in the order in which it is
    written. Raises `DriverError` for a quantity that its object cannot hold."""
    asked = (_setting(each, train, profile) for each in profile.settings)
    found = [setting for setting in asked if setting is not None]
    if profile.interpolation_ms is not None:
        why = "interpolation and RPDO timeout, ms"
        found.append(Setting(0x60C2, 1, profile.interpolation_ms, 1, why))
    for option, index in OPTION_OBJECTS.items():
        code = getattr(profile.options, option)
        if code is not None:
            found.append(Setting(index, 0, code, 2, _WHY[option]))
    return tuple(found)


def _setting(each: DriveSetting, train: DriveTrain, profile: DriveProfile) -> Setting | None:
    """None for a quantity that the axis does not state."""
    value = each.value
    if value is None:
        assert each.quantity is not None
        section, name = each.quantity.split(".")
        one = UNITS[UNIT_OF[each.quantity]][each.unit]
        part = getattr(train, section)
        amount = None if part is None else getattr(part, name)
        if amount is None:
            return None
        value = round(amount * one)
        if not fits(value, each.length):
            raise DriverError(
                f"{profile.name}: {each.name} ({each.why}) is {value}, which does not fit "
                f"{each.length} bytes; correct robot.{each.quantity} or the profile's length"
            )
    kind = _KINDS[each.action]
    return Setting(each.index, each.subindex, value, each.length, each.why, kind)


@dataclass(frozen=True)
class Scale:
    """Device units of one axis against SI at its drum, reeling in positive: both factors are
    negative for a motor that turns the other way."""

    radian_per_increment: float
    newton_metre_per_mille: float
    mille_per_newton_metre: float
    mille_limit: int
    """largest magnitude of a target torque: the current limit, and what 16 bits hold"""

    @staticmethod
    def of(
        train: DriveTrain,
        sign: int = 1,
        rated_torque: float | None = None,
        counts: float | None = None,
    ) -> Scale:
        """``sign``: 1, or -1 for a motor that turns down to reel in. ``rated_torque`` (N m at the
        motor) and ``counts`` (of 0x6064 a motor revolution) are the drive's own; None: those of the
        motor section."""
        motor, ratio = train.motor, train.gearbox.ratio
        if rated_torque is None:
            limit = math.floor(PER_MILLE * motor.current_limit / motor.nominal_current)
        else:
            most = motor.current_limit * motor.torque_constant
            limit = math.floor(PER_MILLE * most / rated_torque + _ROUNDING)
        rated = sign * (motor.rated_torque if rated_torque is None else rated_torque) * ratio
        per_revolution = motor.increments_per_revolution if counts is None else counts
        return Scale(
            radian_per_increment=sign * 2.0 * math.pi / (per_revolution * ratio),
            newton_metre_per_mille=rated / PER_MILLE,
            mille_per_newton_metre=PER_MILLE / rated,
            mille_limit=min(limit, INT16_MAX),
        )


async def read_scale(
    access: ObjectAccess, profile: DriveProfile, train: DriveTrain, sign: int
) -> Scale:
    """The scale of a drive that has been configured, read from it as its profile asks. Raises
    `DriverError` where the drive tells none, and `SdoError`."""
    scaling = profile.scaling
    rated = counts = None
    if scaling.torque != "motor":
        index = int(scaling.torque, 16)
        found = await _positive(access, index, 0)
        if index == RATED_CURRENT:
            rated = found * 1e-3 * train.motor.torque_constant
        else:
            rated = found / UNITS["N m"][scaling.torque_unit]
    if scaling.position != "motor":
        above, below = await _ratio(access, int(scaling.position, 16))
        counts = above / below
        try:
            gear = await _ratio(access, GEAR_RATIO)
        except SdoAbortError as error:
            if error.code != NO_SUCH_OBJECT:
                raise
        else:
            counts *= gear[1] / gear[0]
    return Scale.of(train, sign, rated, counts)


async def _ratio(access: ObjectAccess, index: int) -> tuple[int, int]:
    """Subindices 1 and 2."""
    return await _positive(access, index, 1), await _positive(access, index, 2)


async def _positive(access: ObjectAccess, index: int, subindex: int) -> int:
    found = int.from_bytes(await access.read(index, subindex), "little")
    if not found:
        raise DriverError(
            f"0x{index:04X}:{subindex} reads 0, so the drive's scale is unknown; set it in the "
            "drive, or take the profile's scaling from the motor section"
        )
    return found
