"""A drive as data: what is written into it at bring-up, what its numbers and its errors mean.

The objects are those of CiA 402 (IEC 61800-7-201) and CiA 301; a profile states where a drive
differs from them.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from tonus.config.schema.base import Count, NonNegative, Section

MappingEntry = Annotated[int, Field(ge=0x10000000, le=0xFFFFFFFF)]
"""A PDO mapping word of CiA 301: index << 16 | subindex << 8 | length in bits."""
Index = Annotated[int, Field(ge=0x1000, le=0xFFFF)]
Subindex = Annotated[int, Field(ge=0, le=0xFF)]
ErrorCode = Annotated[int, Field(ge=1, le=0xFFFF)]
FRAME_BITS = 64

UNITS = {
    "A": {"A": 1.0, "mA": 1e3},
    "N m": {"N m": 1.0, "mN m": 1e3, "uN m": 1e6},
    "N m/A": {"N m/A": 1.0, "mN m/A": 1e3, "uN m/A": 1e6},
    "rpm": {"rpm": 1.0},
    "rpm/s": {"rpm/s": 1.0},
    "s": {"s": 1.0, "0.1 s": 10.0},
    "ms": {"ms": 1.0},
    "": {"": 1.0},
}
"""Of each quantity's own unit: the units an object may have it in, and how many make one."""
Quantity = Literal[
    "motor.nominal_current",
    "motor.current_limit",
    "motor.torque_constant",
    "motor.rated_torque",
    "motor.nominal_speed_rpm",
    "motor.maximum_speed_rpm",
    "motor.quick_stop_rpm_s",
    "motor.thermal_time_constant",
    "motor.encoder_pulses",
    "motor.increments_per_revolution",
    "gearbox.numerator",
    "gearbox.denominator",
    "brake.opening_ms",
    "brake.closing_ms",
]
UNIT_OF: dict[Quantity, str] = {
    "motor.nominal_current": "A",
    "motor.current_limit": "A",
    "motor.torque_constant": "N m/A",
    "motor.rated_torque": "N m",
    "motor.nominal_speed_rpm": "rpm",
    "motor.maximum_speed_rpm": "rpm",
    "motor.quick_stop_rpm_s": "rpm/s",
    "motor.thermal_time_constant": "s",
    "motor.encoder_pulses": "",
    "motor.increments_per_revolution": "",
    "gearbox.numerator": "",
    "gearbox.denominator": "",
    "brake.opening_ms": "ms",
    "brake.closing_ms": "ms",
}
"""What of an axis an object can carry, and the unit the configuration has it in."""


class Identity(Section):
    vendor: int
    product: int
    minimum_revision: int


class Device(Section):
    """Settings of every node of one kind at bring-up."""

    identity: Identity | None = None
    """what 0x1018 must say; null: any device"""
    heartbeat_ms: Count
    """producer period written to 0x1017"""
    rpdo: tuple[MappingEntry, ...] = ()
    tpdo: tuple[MappingEntry, ...]

    @model_validator(mode="after")
    def _fits_a_frame(self) -> Device:
        for name in ("rpdo", "tpdo"):
            bits = sum(entry & 0xFF for entry in getattr(self, name))
            if bits > FRAME_BITS:
                raise ValueError(
                    f"{name} maps {bits} bits, a CAN frame carries {FRAME_BITS}; map fewer objects"
                )
        return self


class DriveSetting(Section):
    """One object at bring-up: a fixed ``value``, or a ``quantity`` of its axis in ``unit``. A
    quantity that the axis does not state, such as one of a brake, is left out."""

    index: Index
    subindex: Subindex = 0
    length: Literal[1, 2, 4, 8]
    """bytes"""
    value: int | None = None
    quantity: Quantity | None = None
    unit: str = ""
    action: Literal["write", "check", "command"] = "write"
    """write: unless the value is there already, then read back; check: only read and compared;
    command: written and not read back, because it acts"""
    why: str
    """for people; completes "this is ...\""""

    @property
    def name(self) -> str:
        return f"0x{self.index:04X}:{self.subindex}"

    @model_validator(mode="after")
    def _one_source(self) -> DriveSetting:
        if (self.value is None) == (self.quantity is None):
            raise ValueError("a setting has either a value or a quantity; give it one of the two")
        units = UNITS[UNIT_OF[self.quantity] if self.quantity else ""]
        if self.unit not in units:
            known = ", ".join(filter(None, units)) or "none"
            raise ValueError(
                f"{self.quantity or 'a fixed value'} has no unit {self.unit!r}; choose {known}"
            )
        if self.value is not None and not fits(self.value, self.length):
            raise ValueError(f"{self.value} does not fit {self.length} bytes; change one of them")
        return self


def fits(value: int, length: int) -> bool:
    """Whether so many bytes hold a value, signed or not."""
    return -(1 << 8 * length - 1) <= value < 1 << 8 * length


def _as_written(value: Any) -> Any:
    """YAML reads an index without quotes as a number."""
    return f"0x{value:04X}" if isinstance(value, int) and not isinstance(value, bool) else value


class Scaling(Section):
    """What the drive's torque and position count in: by the robot's motor section, or by objects
    that are read from each drive at bring-up."""

    torque: Annotated[Literal["motor", "0x6076", "0x6075"], BeforeValidator(_as_written)]
    """what 1000 per mille stand for: the motor section's rated torque, the motor rated torque
    0x6076, or the motor rated current 0x6075 (mA) times the motor section's torque constant"""
    torque_unit: Literal["mN m", "uN m"] = "mN m"
    """of 0x6076; mN m in CiA 402"""
    position: Annotated[Literal["motor", "0x608F", "0x6092"], BeforeValidator(_as_written)]
    """what 0x6064 counts in a motor revolution: the motor section's increments, or the position
    encoder resolution 0x608F, or the feed constant 0x6092; of the two objects a gear ratio 0x6091,
    where the drive has one, takes its part"""


Option = Literal[
    "abort_connection",
    "quick_stop",
    "shutdown",
    "disable_operation",
    "halt",
    "fault_reaction",
]
OPTION_OBJECTS: dict[Option, int] = {
    "abort_connection": 0x6007,
    "quick_stop": 0x605A,
    "shutdown": 0x605B,
    "disable_operation": 0x605C,
    "halt": 0x605D,
    "fault_reaction": 0x605E,
}
OptionCode = Annotated[int, Field(ge=-0x8000, le=0x7FFF)]


class DriveOptions(Section):
    """CiA 402 option codes: how a drive stops. One that is not stated is not written."""

    abort_connection: OptionCode | None = None
    """0x6007, the master is gone: 0 nothing, 1 fault, 2 power off, 3 quick stop"""
    quick_stop: OptionCode | None = None
    """0x605A: 0 power off, 1 slow-down ramp, 2 quick stop ramp; 5, 6 the same and stay"""
    shutdown: OptionCode | None = None
    """0x605B: 0 power off, 1 ramp"""
    disable_operation: OptionCode | None = None
    """0x605C: 0 power off, 1 ramp"""
    halt: OptionCode | None = None
    """0x605D: 1 slow-down ramp, 2 quick stop ramp"""
    fault_reaction: OptionCode | None = None
    """0x605E: 0 power off, 1 ramp, 2 quick stop ramp"""


class SupportedOptions(Section):
    """The codes a drive has for each option; none: it does not have the object."""

    abort_connection: tuple[OptionCode, ...] = ()
    quick_stop: tuple[OptionCode, ...] = ()
    shutdown: tuple[OptionCode, ...] = ()
    disable_operation: tuple[OptionCode, ...] = ()
    halt: tuple[OptionCode, ...] = ()
    fault_reaction: tuple[OptionCode, ...] = ()


Reaction = Literal["power_off", "abort_connection", "fault_reaction", "warning"]
Reset = Literal["fault_reset", "in_range", "communication_reset", "device_reset", "history"]


class DriveError(Section):
    """A code of 0x603F, or several in a row with one meaning."""

    code: ErrorCode
    last: ErrorCode | None = None
    """of the row"""
    text: str
    reaction: Reaction | None = None
    """what the drive does: power off at once, as 0x6007 or 0x605E has it, only warn; null: the
    maker does not say"""
    reset: Reset = "fault_reset"
    """what clears it: a fault reset; that with the value back in range, after NMT reset
    communication; a reset of the device; the history cleared"""
    loses_position: bool = False
    """a fault reset sets the position to zero"""

    @model_validator(mode="after")
    def _forward(self) -> DriveError:
        if self.last is not None and self.last < self.code:
            raise ValueError("a row of codes must run forward; exchange code and last")
        return self


class EthercatPart(Section):
    """What is different where the drive is on EtherCAT."""

    identity: Identity | None = None
    """what the slave's EEPROM must say; null: any device"""
    rpdo: tuple[MappingEntry, ...]
    tpdo: tuple[MappingEntry, ...]
    pdo_entries: Count = 8
    """objects that one PDO of the drive takes"""
    pdo_bytes: Count = 32

    @model_validator(mode="after")
    def _fits_a_pdo(self) -> EthercatPart:
        for name in ("rpdo", "tpdo"):
            entries = getattr(self, name)
            size = sum(entry & 0xFF for entry in entries) / 8
            if len(entries) > self.pdo_entries or size > self.pdo_bytes:
                raise ValueError(
                    f"{name} maps {len(entries)} objects of {size:g} bytes, a PDO of the drive "
                    f"holds {self.pdo_entries} of {self.pdo_bytes}; map fewer"
                )
        return self


class Sheet(Section):
    """An electronic data sheet (EDS, CiA 306): its file name and the whole text, so that a
    configuration, and a log of it, are complete without the file."""

    name: str
    text: str


class DriveProfile(Device):
    """One kind of drive in cyclic synchronous torque, on CANopen and on EtherCAT (CoE)."""

    name: str
    """for people: EPOS4"""
    rpdo: tuple[MappingEntry, ...]
    ethercat: EthercatPart | None = None
    """null: the same identity and mappings as on CANopen"""
    eds: Sheet | None = None
    """its object dictionary, which the lab's emulated drive has; in YAML the name of the file, from
    the folder of the file it stands in"""
    emulated_as: Literal["epos4"] | None = None
    """the lab's own model of this drive, which takes the place of an EDS"""
    settings: tuple[DriveSetting, ...]
    """in the order in which they are written; then 0x60C2, the options, and on CANopen 0x1029"""
    scaling: Scaling
    interpolation_ms: Annotated[int, Field(ge=0, le=100)] | None
    """0x60C2:1: 0 for none, else the period of the tick; null: not written"""
    master_timeout_ms: Count | None = None
    """heartbeat consumer 0x1016: the drive leaves Operation Enabled when the daemon is silent;
    null: as `tolerance` has it (`tonus.config.timeouts`)"""
    watches_master: bool = True
    """it has a heartbeat consumer, 0x1016; false: on CANopen nothing stops it without the daemon,
    which `tonus check` takes in a lab only"""
    watches_supervisor: bool = True
    """it has a second one, 0x1016:2; false: the supervisor cannot stop it (docs/supervisor.md)"""
    heartbeat_margin_ms: NonNegative = 0.0
    """the drive's consumer must wait at least this much longer than the producer's period"""
    on_communication_error: Annotated[int, Field(ge=0, le=2)] | None
    """0x1029:1: 0 to pre-operational, 1 no change, 2 stopped; null: not written"""
    options: DriveOptions
    supported_options: SupportedOptions
    errors: tuple[DriveError, ...] = ()

    @model_validator(mode="after")
    def _has_the_options(self) -> DriveProfile:
        for option in OPTION_OBJECTS:
            chosen, known = getattr(self.options, option), getattr(self.supported_options, option)
            if chosen is None or chosen in known:
                continue
            index = f"0x{OPTION_OBJECTS[option]:04X}"
            if not known:
                raise ValueError(f"options.{option}: {self.name} has no {index}; leave it out")
            codes = ", ".join(map(str, known))
            raise ValueError(
                f"options.{option} ({index}) is {chosen}, which {self.name} does not have; "
                f"choose one of {codes}"
            )
        return self

    @model_validator(mode="after")
    def _each_error_once(self) -> DriveProfile:
        last = 0
        for error in sorted(self.errors, key=lambda each: each.code):
            if error.code <= last:
                raise ValueError(f"errors: 0x{error.code:04X} is given twice; keep one")
            last = error.last or error.code
        return self

    @property
    def on_ethercat(self) -> DriveProfile:
        """The same with what is different on EtherCAT in its place."""
        part = self.ethercat
        if part is None:
            return self
        return self.model_copy(
            update={"identity": part.identity, "rpdo": part.rpdo, "tpdo": part.tpdo}
        )
