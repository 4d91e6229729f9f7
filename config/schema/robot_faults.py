"""Faults of the robot itself, and of what is round it: they need no channel and act alike on every
bus. Bounds keep a slip of the pen from the plant."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from tonus.config.schema.base import Finite, NonNegative, Number, Positive, no_boolean
from tonus.config.schema.fault_section import LONGEST_S, FaultSection

Index = Annotated[int, BeforeValidator(no_boolean), Field(ge=0)]
_Newton = Annotated[Finite, Field(ge=-1000.0, le=1000.0)]
_Metre = Annotated[Finite, Field(ge=-1.0, le=1.0)]


class _OfRobot(FaultSection):
    """Happens to the robot behind the buses, or to what is round it."""


class _LastingOfRobot(_OfRobot):
    duration: Annotated[Positive, Field(le=LONGEST_S)] | None = None
    """s; without it until `clear`"""


class _Growing(_LastingOfRobot):
    over: Annotated[NonNegative, Field(le=LONGEST_S)] = 0.0
    """s in which it grows"""


class CableCut(_OfRobot):
    """A cable breaks, for good."""

    kind: Literal["cable_cut"] = "cable_cut"
    axis: Index
    """of the cable and its drum, from 0"""


class DrumSlip(_OfRobot):
    """A cable slips on its drum; the encoder does not see it."""

    kind: Literal["drum_slip"] = "drum_slip"
    axis: Index
    """of the cable and its drum, from 0"""
    length: _Metre
    """m, paid out where positive"""
    duration: Annotated[Number, Field(ge=0.001, le=LONGEST_S)] = 0.05
    """s in which it slips"""


class DrumJam(_LastingOfRobot):
    """A drum cannot turn."""

    kind: Literal["drum_jam"] = "drum_jam"
    axis: Index
    """of the cable and its drum, from 0"""


class DrumFriction(_Growing):
    """Coulomb friction is added in a drum."""

    kind: Literal["drum_friction"] = "drum_friction"
    axis: Index
    """of the cable and its drum, from 0"""
    force: Annotated[NonNegative, Field(le=1000.0)]
    """N at the cable, on top of what there is"""


class MotorWeak(_LastingOfRobot):
    """A motor gives only a share of its torque."""

    kind: Literal["motor_weak"] = "motor_weak"
    axis: Index
    """of the cable and its drum, from 0"""
    gain: Annotated[Finite, Field(ge=-1.0, le=1.0)]
    """share of the torque constant that is left; negative: it turns the other way"""


class BrakeWeak(_LastingOfRobot):
    """A holding brake holds only a share of its torque when it is closed."""

    kind: Literal["brake_weak"] = "brake_weak"
    axis: Index
    """of the cable and its drum, from 0"""
    gain: Annotated[Finite, Field(ge=0.0, le=1.0)]
    """share of its torque that is left; 0: it does not hold at all"""


class SafeTorqueOff(_LastingOfRobot):
    """The safe torque off inputs of a drive, or of every drive, lose their voltage."""

    kind: Literal["sto"] = "sto"
    axis: Index | None = None
    """from 0; without it every drive"""


class CellGain(_Growing):
    """A load cell shows a multiple of its force."""

    kind: Literal["cell_gain"] = "cell_gain"
    cell: Index
    """from 0; the last one measures contact"""
    gain: Annotated[Finite, Field(ge=0.0, le=3.0)]
    """shown over true force"""


class CellOffset(_Growing):
    """A load cell shows a force offset."""

    kind: Literal["cell_offset"] = "cell_offset"
    cell: Index
    """from 0; the last one measures contact"""
    force: _Newton
    """N, added to what it shows"""


class CellFrozen(_LastingOfRobot):
    """A load cell repeats the force of this moment; its noise continues."""

    kind: Literal["cell_frozen"] = "cell_frozen"
    cell: Index
    """from 0; the last one measures contact"""


class EncoderSlip(_OfRobot):
    """An encoder slips on its shaft: it is off by an angle from then on."""

    kind: Literal["encoder_slip"] = "encoder_slip"
    axis: Index
    """of the cable and its drum, from 0"""
    angle: Annotated[Finite, Field(ge=-100.0, le=100.0)]
    """rad at the drum, shown less true"""
    over: Annotated[NonNegative, Field(le=LONGEST_S)] = 0.0
    """s in which it grows"""


class EncoderFrozen(_LastingOfRobot):
    """An encoder stops counting; the missed increments are never added."""

    kind: Literal["encoder_frozen"] = "encoder_frozen"
    axis: Index
    """of the cable and its drum, from 0"""


class TrackerHidden(_LastingOfRobot):
    """The platform is hidden from the tracker."""

    kind: Literal["tracker_hidden"] = "tracker_hidden"


class ShiftedTracker(_LastingOfRobot):
    """The tracker's positions are off, as after a knock against it."""

    kind: Literal["tracker_shift"] = "tracker_shift"
    shift: tuple[_Metre, _Metre, _Metre]
    """m, base frame"""


class PhantomHit(_LastingOfRobot):
    """The phantom moves against the contact port, and in the end back."""

    kind: Literal["phantom_hit"] = "phantom_hit"
    distance: Annotated[Positive, Field(le=1.0)]
    """m, towards the port"""
    speed: Annotated[Positive, Field(le=10.0)]
    """m/s"""


class Push(_OfRobot):
    """A person pushes the platform."""

    kind: Literal["load"] = "load"
    force: tuple[_Newton, _Newton, _Newton]
    """N, base frame"""
    point: tuple[_Metre, _Metre, _Metre] = (0.0, 0.0, 0.0)
    """m, in the platform frame"""
    rise: Annotated[NonNegative, Field(le=LONGEST_S)] = 0.0
    """s in which the force rises, and in the end falls"""
    duration: Annotated[Positive, Field(le=LONGEST_S)]
    """s from its begin until it falls"""


class PutBack(_OfRobot):
    """Someone puts the platform into its cradle, and turns the drums until every cable is slack."""

    kind: Literal["put_back"] = "put_back"


OfRobot = (
    CableCut
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
)
