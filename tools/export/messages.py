"""Every frame that a CANopen configuration puts on its channels."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial

from tonus.config import Config
from tonus.config.schema.axis import DriveTrain
from tonus.config.schema.bus import CanopenBus, Channel
from tonus.config.schema.drive import Device, DriveProfile
from tonus.drivers.canopen import identifiers
from tonus.drivers.cia301.pdo import Mapping as PdoMapping
from tonus.drivers.cia301.pdo import PdoError
from tonus.drivers.devices import cia402, force_cell
from tonus.drivers.devices import drive as drives
from tonus.drivers.devices.drive_errors import Errors
from tonus.drivers.process_image import AxisState
from tonus.tools.errors import ToolError
from tonus.tools.export.dbc import Message, Signal

MASTER = "Master"
_STATE_BITS = 7
_FLAGS = {
    7: "Warning",
    8: "Bit8",
    9: "Remote",
    10: "TargetReached",
    11: "InternalLimit",
    12: "FollowsCommand",
    13: "Bit13",
    14: "Bit14",
    15: "Referenced",
}
"""Bits of the statusword above the state, as an EPOS4 in a cyclic mode has them."""
_CONTROLWORDS = {
    cia402.DISABLE_VOLTAGE: "DISABLE_VOLTAGE",
    cia402.QUICK_STOP: "QUICK_STOP",
    cia402.SHUTDOWN: "SHUTDOWN",
    cia402.SWITCH_ON: "SWITCH_ON",
    cia402.ENABLE_OPERATION: "ENABLE_OPERATION",
    cia402.FAULT_RESET: "FAULT_RESET",
}
_NMT_COMMANDS = {
    0x01: "START",
    0x02: "STOP",
    0x80: "ENTER_PRE_OPERATIONAL",
    0x81: "RESET_NODE",
    0x82: "RESET_COMMUNICATION",
}
_NMT_STATES = {0: "BOOT_UP", 4: "STOPPED", 5: "OPERATIONAL", 127: "PRE_OPERATIONAL"}
_CELL_STATUS = {0: "GOOD"}
_SDO = (
    Signal("Command", 0, 8, about="CiA 301, command specifier"),
    Signal("Index", 8, 16),
    Signal("Subindex", 24, 8),
    Signal("Data", 32, 32, about="of an expedited transfer, or an abort code"),
)
Known = Mapping[int, Callable[[int], list[Signal]]]
"""By mapping word: the signals of an object that starts at a bit of its PDO."""


def nodes(config: Config, bus: CanopenBus, channels: tuple[Channel, ...]) -> dict[str, str]:
    """Names with what they are."""
    found = {MASTER: f"the control PC, node {bus.master.node_id}"}
    for channel in channels:
        for drive in channel.drives:
            found[f"Axis{drive.axis}"] = f"drive, node {drive.node_id} on {channel.name}"
        for cell in channel.force_cells:
            name = _cells_name(config, cell.cells)
            found[name] = f"load cell, node {cell.node_id} on {channel.name}"
    return found


def messages(config: Config, bus: CanopenBus, channels: tuple[Channel, ...]) -> list[Message]:
    """In the order of their identifiers; what is the same on several channels once.

    Raises `ToolError` if an identifier means one thing on one channel and another on another, or if
    a PDO cannot be described.
    """
    found: dict[int, tuple[Message, str]] = {}
    everyone = tuple(name for name in nodes(config, bus, channels) if name != MASTER)
    for channel in channels:
        for message in _channel(config, bus, channel, everyone):
            there = found.setdefault(message.identifier, (message, channel.name))
            if there[0] != message:
                raise ToolError(
                    f"identifier 0x{message.identifier:03X} is {there[0].name} on {there[1]} and "
                    f"{message.name} on {channel.name}; choose one of them with --channel"
                )
    return [found[identifier][0] for identifier in sorted(found)]


def _channel(
    config: Config, bus: CanopenBus, channel: Channel, everyone: tuple[str, ...]
) -> Iterator[Message]:
    cycle_ms = config.control.rates.period_us // 1000
    yield Message(
        identifiers.NMT,
        "NMT",
        MASTER,
        everyone,
        2,
        (
            Signal("Command", 0, 8, values=_NMT_COMMANDS),
            Signal("Node", 8, 8, about="0: all nodes"),
        ),
    )
    yield Message(identifiers.SYNC, "SYNC", MASTER, everyone, 0, cycle_ms=cycle_ms)
    yield _heartbeat(MASTER, bus.master.node_id, bus.master.heartbeat_ms, everyone)
    trains, signs = config.robot.drive_trains, config.robot.signs
    for drive in channel.drives:
        axis, profile = drive.axis, bus.profile(drive.axis)
        known, where = _of_drive(profile, trains[axis], signs[axis]), bus.profile_key(axis)
        codes = {code: error.text for code, error in Errors(profile).listed.items()}
        yield from _node(
            f"Axis{axis}", drive.node_id, where, profile, profile.tpdo, known, cycle_ms, codes
        )
    for cell in channel.force_cells:
        name = _cells_name(config, cell.cells)
        known = _of_cells(config, cell.cells, bus.force_cell.decimal_digits)
        tpdo = bus.force_cell.mapping(len(cell.cells))
        where = "fieldbus.force_cell"
        yield from _node(name, cell.node_id, where, bus.force_cell, tpdo, known, cycle_ms, {})


def _node(
    name: str,
    node_id: int,
    where: str,
    device: Device,
    tpdo: tuple[int, ...],
    known: Known,
    cycle_ms: int,
    codes: Mapping[int, str],
) -> Iterator[Message]:
    """``where``: the place of the device's configuration; ``codes``: its errors."""
    yield Message(
        identifiers.EMCY + node_id,
        f"{name}_EMCY",
        name,
        (MASTER,),
        8,
        (
            Signal("ErrorCode", 0, 16, values={0: Errors().text(0), **codes}),
            Signal("ErrorRegister", 16, 8, about="0x1001"),
            Signal("Manufacturer", 24, 40),
        ),
    )
    for mapping, base, suffix, sender, receiver in (
        (tpdo, identifiers.TPDO1, "TPDO1", name, MASTER),
        (device.rpdo, identifiers.RPDO1, "RPDO1", MASTER, name),
    ):
        if mapping:
            length, signals = _process_data(mapping, known, f"{where}.{suffix[:4].lower()}")
            yield Message(
                base + node_id, f"{name}_{suffix}", sender, (receiver,), length, signals, cycle_ms
            )
    yield Message(
        identifiers.SDO_RESPONSE + node_id, f"{name}_SDO_Response", name, (MASTER,), 8, _SDO
    )
    yield Message(
        identifiers.SDO_REQUEST + node_id, f"{name}_SDO_Request", MASTER, (name,), 8, _SDO
    )
    yield _heartbeat(name, node_id, device.heartbeat_ms, (MASTER,))


def _heartbeat(name: str, node_id: int, cycle_ms: int, receivers: tuple[str, ...]) -> Message:
    state = Signal("State", 0, 7, about="NMT state", values=_NMT_STATES)
    return Message(
        identifiers.HEARTBEAT + node_id, f"{name}_Heartbeat", name, receivers, 1, (state,), cycle_ms
    )


def _process_data(
    mapping: tuple[int, ...], known: Known, where: str
) -> tuple[int, tuple[Signal, ...]]:
    """Length in bytes, and signals; an object we have no name for is given raw."""
    found: list[Signal] = []
    start = 0
    for entry in mapping:
        make = known.get(entry)
        found += make(start) if make is not None else [_raw(entry, start, where)]
        start += entry & 0xFF
    return -(-start // 8), tuple(found)


def _raw(entry: int, start: int, where: str) -> Signal:
    index, subindex, bits = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
    try:
        letter = PdoMapping.of((entry,)).layout.format[-1]
    except PdoError as error:
        raise ToolError(f"{where}: {error}") from error
    return Signal(
        f"Object_{index:04X}_{subindex:02X}",
        start,
        bits,
        "real" if letter == "f" else "signed" if letter.islower() else "unsigned",
        about=f"object 0x{index:04X}:{subindex}, unscaled",
    )


def _of_drive(profile: DriveProfile, train: DriveTrain, sign: int) -> Known:
    """A value whose scale only the drive itself knows is given raw."""
    scale, scaling = drives.Scale.of(train, sign), profile.scaling
    position = Signal(
        "Position",
        0,
        32,
        "signed",
        scale.radian_per_increment,
        "rad",
        "at the drum; 0 is where the drive was switched on",
    )
    torque = Signal(
        "Torque",
        0,
        16,
        "signed",
        scale.newton_metre_per_mille,
        "N m",
        "at the drum, before gearbox losses",
    )
    if scaling.position != "motor":
        about = f"0x6064, in the drive's own units by {scaling.position}"
        position = replace(position, factor=1.0, unit="", about=about)
    if scaling.torque != "motor":
        about = f"per mille of the drive's own {scaling.torque}"
        torque = replace(torque, factor=1.0, unit="", about=about)
    controlword = Signal("Controlword", 0, 16, about="CiA 402", values=_CONTROLWORDS)
    return {
        drives.STATUSWORD: _statusword,
        drives.POSITION_ACTUAL: partial(_placed, position),
        drives.TORQUE_ACTUAL: partial(_placed, torque),
        drives.TARGET_TORQUE: partial(_placed, replace(torque, name="TargetTorque")),
        drives.CONTROLWORD: partial(_placed, controlword),
    }


def _placed(signal: Signal, start: int) -> list[Signal]:
    return [replace(signal, start=start)]


def _statusword(start: int) -> list[Signal]:
    """The state has a table of its own, so the bits above it are signals beside it."""
    defined = {
        word: cia402.decode(word)
        for word in range(1 << _STATE_BITS)
        if cia402.decode(word) is not AxisState.NOT_READY or word & 0x4F == 0
    }
    state = Signal(
        "Statusword_State",
        start,
        _STATE_BITS,
        about="CiA 402, bits 0 to 6",
        values={word: state.name for word, state in defined.items()},
    )
    flags = (
        Signal(f"Statusword_{name}", start + bit, 1, about=f"bit {bit}")
        for bit, name in _FLAGS.items()
    )
    return [state, *flags]


def _of_cells(config: Config, cells: tuple[int, ...], digits: int) -> Known:
    """Each channel's signals; where there are several they carry their cell's name."""
    known: dict[int, Callable[[int], list[Signal]]] = {}
    for channel, cell in enumerate(cells, start=1):
        suffix = f"_{_cell_name(config, cell)}" if len(cells) > 1 else ""
        force = Signal(f"Force{suffix}", 0, 32, "signed", 10.0**-digits, "N")
        status = Signal(f"Status{suffix}", 0, 8, about="CiA 404, 0x6150", values=_CELL_STATUS)
        for entry, signal in (
            (force_cell.INT32, force),
            (force_cell.INT16, replace(force, bits=16)),
            (force_cell.REAL32, replace(force, kind="real", factor=1.0)),
            (force_cell.STATUS, status),
        ):
            known[force_cell.of_channel(entry, channel)] = partial(_placed, signal)
    return known


def _cells_name(config: Config, cells: tuple[int, ...]) -> str:
    return "_".join(_cell_name(config, cell) for cell in cells)


def _cell_name(config: Config, cell: int) -> str:
    return "Contact" if cell == config.robot.contact_cell else f"Cell{cell}"
