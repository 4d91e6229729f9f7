"""The EPOS4 in cyclic synchronous torque: what is configured, and what its numbers mean.

Torque scale: 1000 per mille of 0x6071 and 0x6077 are 0x6076 = 0x3001:1 * 0x3001:5 / 1000 (uN m) at
the motor, gear not included. Position: increments of the motor's encoder.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from tonus.config.schema.axis import DriveTrain, Motor
from tonus.config.schema.bus import Drive, EthercatDrive
from tonus.drivers.cia301.setting import Kind, Setting
from tonus.drivers.errors import DriverError

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

PDOS = 4
INT16_MAX = 0x7FFF
PER_MILLE = 1000


def require_interpolation(drive: Drive | EthercatDrive, period_us: int) -> None:
    """Raises `DriverError` for a 0x60C2 that is neither 0 nor the period of the tick."""
    if drive.interpolation_ms * 1000 not in (0, period_us):
        raise DriverError(
            f"fieldbus.drive.interpolation_ms is {drive.interpolation_ms}; it must be 0 or the "
            f"period of {period_us} us, or drives fault with 0x8250"
        )


def settings(motor: Motor, drive: Drive | EthercatDrive) -> tuple[Setting, ...]:
    """What the EPOS4 of a ``motor`` must hold before it is started, in the order in which it is
    written."""
    options = drive.options
    return (
        Setting(0x6040, 0, 0, 2, "power off: some objects change only then", Kind.COMMAND),
        Setting(0x3001, 1, round(motor.nominal_current * 1e3), 4, "nominal current, mA"),
        Setting(0x3001, 2, round(motor.current_limit * 1e3), 4, "current limit, mA"),
        Setting(0x3001, 5, round(motor.torque_constant * 1e6), 4, "torque constant, uN m/A"),
        Setting(0x6076, 0, round(motor.rated_torque * 1e6), 4, "rated torque, uN m", Kind.CHECK),
        Setting(0x3010, 1, motor.encoder_pulses, 4, "encoder pulses per revolution"),
        # Before the mode: a target left over from another master must not act.
        Setting(0x6071, 0, 0, 2, "target torque"),
        Setting(0x6060, 0, CYCLIC_SYNCHRONOUS_TORQUE, 1, "cyclic synchronous torque"),
        Setting(0x60C2, 1, drive.interpolation_ms, 1, "interpolation and RPDO timeout, ms"),
        Setting(0x6007, 0, options.abort_connection, 2, "when the connection is lost"),
        Setting(0x605A, 0, options.quick_stop, 2, "quick stop"),
        Setting(0x605B, 0, options.shutdown, 2, "shutdown"),
        Setting(0x605C, 0, options.disable_operation, 2, "disable operation"),
        Setting(0x605E, 0, options.fault_reaction, 2, "fault reaction"),
    )


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
    def of(train: DriveTrain, sign: int = 1) -> Scale:
        """``sign``: 1, or -1 for a motor that turns down to reel in."""
        motor, ratio = train.motor, train.gearbox.ratio
        rated = sign * motor.rated_torque * ratio
        limit = math.floor(PER_MILLE * motor.current_limit / motor.nominal_current)
        return Scale(
            radian_per_increment=sign * 2.0 * math.pi / (motor.increments_per_revolution * ratio),
            newton_metre_per_mille=rated / PER_MILLE,
            mille_per_newton_metre=PER_MILLE / rated,
            mille_limit=min(limit, INT16_MAX),
        )
