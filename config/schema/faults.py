"""Faults a lab can be asked for: in a scenario's ``lab: faults:``, at its door, or from a test.

One kind, one class; a class holds what its fault needs and nothing else.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, TypeAdapter

from tonus.config.schema.base import Count, Finite, Fraction, NodeId, Positive
from tonus.config.schema.fault_section import LONGEST_S, FaultSection
from tonus.config.schema.robot_faults import (
    BrakeWeak,
    CableCut,
    CellFrozen,
    CellGain,
    CellOffset,
    DrumFriction,
    DrumJam,
    DrumSlip,
    EncoderFrozen,
    EncoderSlip,
    MotorWeak,
    PhantomHit,
    Push,
    PutBack,
    SafeTorqueOff,
    ShiftedTracker,
    TrackerHidden,
)

Level = Literal["dominant", "recessive"]
Identifier = Annotated[int, Field(ge=0, le=0x7FF)]
Unsigned = Annotated[int, Field(ge=0, le=0xFFFFFFFF)]
SlaveState = Literal["init", "pre_op", "safe_op", "op"]


class _OfChannel(FaultSection):
    channel: str
    """its name in the fieldbus; of an EtherCAT segment the master's interface"""


class _Lasting(_OfChannel):
    duration: Annotated[Positive, Field(le=LONGEST_S)] | None = None
    """s; without it until `clear`"""


class _OfNode(_OfChannel):
    node: NodeId
    """its id on the channel; on EtherCAT its place along the cable, from 1"""


class Unplug(_OfNode):
    """The node's cable is pulled; the device runs on, and no node acknowledges its frames."""

    kind: Literal["unplug"] = "unplug"


class Replug(_OfNode):
    """The node's cable is put back."""

    kind: Literal["replug"] = "replug"


class PowerCycle(_OfNode):
    """The node's supply is interrupted: it restarts from its stored parameters."""

    kind: Literal["power_cycle"] = "power_cycle"


class DriveError(_OfNode):
    """The drive raises an error of its own (CiA 402 error code)."""

    kind: Literal["drive_error"] = "drive_error"
    code: Annotated[int, Field(ge=1, le=0xFFFF)]
    """one of the drive's own"""


class DriveInput(_OfNode):
    """Something wired to the drive changes its level."""

    kind: Literal["drive_input"] = "drive_input"
    input: Literal["negative_limit", "positive_limit", "home", "quick_stop", "drive_enable", "sto"]
    """by its function"""
    active: bool = True
    """whether the function acts"""


class CellBreak(_OfNode):
    """The bridge of a load cell opens, or is repaired."""

    kind: Literal["cell_break"] = "cell_break"
    broken: bool = True
    """false: repaired"""


class _OfFrames(_Lasting):
    """Happens to frames of one channel, until its count, its time or `ClearFaults` ends it."""

    identifier: Identifier | None = None
    """only frames with this identifier; without it all"""
    probability: Fraction = 1.0
    """with which a frame is hit"""
    frames: Count | None = None
    """largest number of frames"""


class Loss(_OfFrames):
    """No node receives the frame, and its sender detects no error."""

    kind: Literal["loss"] = "loss"


class Corruption(_OfFrames):
    """A bit is flipped on the wire: error frame, error counters, and the frame is sent again."""

    kind: Literal["corruption"] = "corruption"


class Delay(_OfFrames):
    """The frame enters its sender's queue later than it should, and is overtaken there."""

    kind: Literal["delay"] = "delay"
    delay_us: Count
    """by how much"""


class Duplicate(_OfFrames):
    """Its controller sends the frame twice, as where an error in the last bit is seen by it alone;
    no controller counts an error, and its host hears of one frame."""

    kind: Literal["duplicate"] = "duplicate"


class Babble(_Lasting):
    """A defective controller sends one identifier without pause."""

    kind: Literal["babble"] = "babble"
    identifier: Identifier = 0
    """that it sends"""
    period_us: Count = 1
    """between its frames; less than a frame takes: back to back"""


class StuckBus(_Lasting):
    """The bus is held at a level and no node can send.

    Held dominant (a wire on the supply), all controllers become error-passive, and the one that was
    sending goes bus-off. Recessive (the wires touch), every one that tries to send goes bus-off.
    """

    kind: Literal["stuck"] = "stuck"
    level: Level = "dominant"
    """what it is held at"""


class Disconnect(_Lasting):
    """The channel's cable is cut behind the daemon's controller: no node acknowledges its frames;
    the devices stay connected to each other. Every other host of the channel is isolated in the
    same way."""

    kind: Literal["disconnect"] = "disconnect"


class _LastingOfNode(_OfNode):
    duration: Annotated[Positive, Field(le=LONGEST_S)] | None = None
    """s; without it until `clear`"""


class PowerLoss(_LastingOfNode):
    """A slave of an EtherCAT segment has no supply: its ports close, and those behind it are cut
    off."""

    kind: Literal["power_loss"] = "power_loss"


class CableBreak(_Lasting):
    """An EtherCAT segment's cable breaks between two slaves."""

    kind: Literal["cable_break"] = "cable_break"
    behind: Annotated[int, Field(ge=0)]
    """number of slaves that still answer; in a ring the others answer from its far end"""


class WrongIdentity(_LastingOfNode):
    """A slave of an EtherCAT segment reports another identity than the configured one."""

    kind: Literal["wrong_identity"] = "wrong_identity"
    vendor: Unsigned | None = None
    """in place of its own"""
    product: Unsigned | None = None
    """in place of its own"""
    revision: Unsigned | None = None
    """in place of its own"""


class StateDrop(_OfNode):
    """A slave of an EtherCAT segment falls to a state by itself, with an AL status code."""

    kind: Literal["state_drop"] = "state_drop"
    state: SlaveState = "safe_op"
    """to which it falls"""
    code: Annotated[int, Field(ge=0, le=0xFFFF)] = 0x001B
    """AL status code; 0: no error flag"""


class StateRefusal(_LastingOfNode):
    """A slave of an EtherCAT segment refuses a state."""

    kind: Literal["state_refusal"] = "state_refusal"
    state: SlaveState
    """that it refuses"""
    code: Annotated[int, Field(ge=1, le=0xFFFF)]
    """AL status code with which it does"""


class MailboxAbort(_OfNode):
    """A slave of an EtherCAT segment aborts accesses to an object."""

    kind: Literal["mailbox_abort"] = "mailbox_abort"
    index: Annotated[int, Field(ge=0, le=0xFFFF)]
    """of the object"""
    subindex: Annotated[int, Field(ge=0, le=0xFF)] | None = None
    """without it any"""
    code: Unsigned = 0x08000000
    """SDO abort code"""
    times: Count = 1
    """number of accesses"""


class WatchdogExpiry(_OfNode):
    """The process data watchdog of a slave of an EtherCAT segment expires: SAFE-OP, code 0x001B."""

    kind: Literal["watchdog"] = "watchdog"


class ClockDrift(_LastingOfNode):
    """The clock of a slave of an EtherCAT segment drifts."""

    kind: Literal["clock_drift"] = "clock_drift"
    drift_ppm: Annotated[Finite, Field(ge=-1000, le=1000)]
    """faster than the lab's time"""


class ClearFaults(FaultSection):
    """End every lasting fault of a channel, or all there are."""

    kind: Literal["clear"] = "clear"
    channel: str | None = None
    """without it all, those of the robot among them"""


Fault = Annotated[
    Unplug
    | Replug
    | PowerCycle
    | DriveError
    | DriveInput
    | CellBreak
    | Loss
    | Corruption
    | Delay
    | Duplicate
    | Babble
    | StuckBus
    | Disconnect
    | PowerLoss
    | CableBreak
    | WrongIdentity
    | StateDrop
    | StateRefusal
    | MailboxAbort
    | WatchdogExpiry
    | ClockDrift
    | CableCut
    | DrumSlip
    | DrumJam
    | DrumFriction
    | MotorWeak
    | BrakeWeak
    | SafeTorqueOff
    | CellGain
    | CellOffset
    | CellFrozen
    | EncoderSlip
    | EncoderFrozen
    | TrackerHidden
    | ShiftedTracker
    | PhantomHit
    | Push
    | PutBack
    | ClearFaults,
    Field(discriminator="kind"),
]
FAULT: TypeAdapter[Fault] = TypeAdapter(Fault)
