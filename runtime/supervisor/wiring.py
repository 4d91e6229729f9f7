"""Which bits of which frame are which axis' or cell's numbers, from the configuration alone."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from tonus.config.schema.axis import Motor
from tonus.config.schema.bus import Amplifier, CanopenBus, ForceCell
from tonus.config.schema.root import Config

_SYNC = 0x080
_EMERGENCY, _TPDO, _RPDO, _REQUEST, _HEARTBEAT = 0x080, 0x180, 0x200, 0x600, 0x700
_CONTROLWORD, _STATUSWORD, _POSITION, _TARGET_TORQUE = 0x6040, 0x6041, 0x6064, 0x6071
_REAL_VALUE = 0x6130
_PROCESS_VALUES = (_REAL_VALUE, 0x7130, 0x9130)
_REAL = struct.Struct("<f")


@dataclass(frozen=True)
class Value:
    """A number in a frame's eight bytes, read as one little-endian word."""

    shift: int
    bits: int
    real: bool = False
    """a float of 32 bits; else an integer with a sign"""

    def number(self, word: int) -> float:
        if self.real:
            return self.numbers((word,))[0]
        sign = 1 << self.bits - 1
        return ((word >> self.shift & (sign << 1) - 1) ^ sign) - sign

    def numbers(self, words: Iterable[int]) -> list[float]:
        """Of several frames, in their order."""
        shift, mask = self.shift, (1 << self.bits) - 1
        if self.real:
            read = _REAL.unpack
            return [read((word >> shift & mask).to_bytes(4, "little"))[0] for word in words]
        sign = 1 << self.bits - 1
        return [((word >> shift & mask) ^ sign) - sign for word in words]


@dataclass(frozen=True)
class Axis:
    number: int
    channel: str
    sent: int
    """identifier of what the drive is sent"""
    received: int
    """identifier of what it answers"""
    sent_bytes: int
    received_bytes: int
    torque: Value
    statusword: Value
    position: Value
    newton: float | None
    """at the cable for one per mille of rated torque; None: only the drive knows its scale"""
    per_newton_metre: float
    """per mille for one newton metre at the drum"""
    limit: int
    """per mille, either way, of the motor's current limit"""
    metre: float | None
    """of cable for one increment, reeling in; None like ``newton``"""
    mass: float
    """kg of the drum at the cable"""
    damping: float
    """N s/m of its bearings"""
    radius: float | None
    """m of the drum; None where the record alone tells its angle, or like ``newton``"""
    heartbeat: int = 0
    """identifier of the drive's own; 0 where its frames are not read"""
    sync: int = 0
    """identifier of what makes it act by the torque it was sent, the same way"""
    request: int = 0
    """identifier under which its objects are read and written (SDO), the same way"""
    controlword: Value | None = None
    """in what the drive is sent, the same way"""


@dataclass(frozen=True)
class Cell:
    number: int
    channel: str
    received: int
    received_bytes: int
    force: Value
    newton: float
    """for one unit"""
    emergency: int
    """identifier under which its amplifier reports an error"""
    heartbeat: int = 0
    """identifier of the amplifier's; 0 where its frames are not read"""
    request: int = 0
    """identifier under which its objects are read and written (SDO), the same way"""


class Wiring:
    """Every axis and cell on a CAN channel of the configuration."""

    def __init__(self, config: Config) -> None:
        self.channels: list[tuple[str, str, int]] = []
        """python-can interface, name and bit rate of each channel"""
        self.axes: list[Axis] = []
        self.cells: list[Cell] = []
        for bus in config.fieldbus.parts:
            if isinstance(bus, CanopenBus):
                self._add(config, bus)

    def _add(self, config: Config, bus: CanopenBus) -> None:
        robot = config.robot
        for channel in bus.channels:
            self.channels.append((bus.interface, channel.name, bus.bitrate))
            for drive in channel.drives:
                axis, profile = drive.axis, bus.profile(drive.axis)
                train, sign = robot.drive_trains[axis], robot.signs[axis]
                ratio, radius = train.gearbox.ratio, train.drum.radius
                own = profile.scaling.torque == profile.scaling.position == "motor"
                mille = sign * train.motor.rated_torque * 1e-3
                turn = sign * 2.0 * math.pi / train.motor.increments_per_revolution
                self.axes.append(
                    Axis(
                        axis,
                        channel.name,
                        _RPDO + drive.node_id,
                        _TPDO + drive.node_id,
                        _bytes(profile.rpdo),
                        _bytes(profile.tpdo),
                        _value(profile.rpdo, _TARGET_TORQUE),
                        _value(profile.tpdo, _STATUSWORD),
                        _value(profile.tpdo, _POSITION),
                        mille * ratio / radius if own else None,
                        1.0 / (mille * ratio),
                        limit_of(train.motor),
                        turn / ratio * radius if own else None,
                        train.drum.inertia / radius**2,
                        train.drum.viscous_friction / radius**2,
                        radius if own else None,
                        _HEARTBEAT + drive.node_id,
                        _SYNC,
                        _REQUEST + drive.node_id,
                        _value(profile.rpdo, _CONTROLWORD),
                    )
                )
            for node in channel.force_cells:
                mapping = bus.force_cell.mapping(len(node.cells))
                forces = forces_of(bus.force_cell, len(node.cells))
                for (force, newton), number in zip(forces, node.cells, strict=False):
                    self.cells.append(
                        Cell(
                            number,
                            channel.name,
                            _TPDO + node.node_id,
                            _bytes(mapping),
                            force,
                            newton,
                            _EMERGENCY + node.node_id,
                            _HEARTBEAT + node.node_id,
                            _REQUEST + node.node_id,
                        )
                    )


def limit_of(motor: Motor) -> int:
    """Per mille of its rated torque."""
    return math.floor(1e3 * motor.current_limit / motor.nominal_current)


def forces_of(kind: ForceCell | Amplifier, cells: int) -> list[tuple[Value, float]]:
    """Of each cell of a node: where its force is, and N for one unit."""
    mapping, unit = kind.mapping(cells), 10.0**-kind.decimal_digits
    return [
        (
            _value(mapping, entry >> 16, entry >> 8 & 0xFF),
            1.0 if entry >> 16 == _REAL_VALUE else unit,
        )
        for entry in mapping
        if entry >> 16 in _PROCESS_VALUES
    ]


def _value(mapping: Sequence[int], index: int, subindex: int = 0) -> Value:
    shift = 0
    for entry in mapping:
        if (entry >> 16, entry >> 8 & 0xFF) == (index, subindex):
            return Value(shift, entry & 0xFF, index == _REAL_VALUE)
        shift += entry & 0xFF
    raise ValueError(f"no PDO maps 0x{index:04X}:{subindex}")


def _bytes(mapping: Sequence[int]) -> int:
    return sum(entry & 0xFF for entry in mapping) // 8
