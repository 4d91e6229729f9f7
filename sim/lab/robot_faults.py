"""The schema's faults of the robot itself: whether this one can have them, and what they do."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tonus.config.schema.robot import Robot
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
    OfRobot,
    PhantomHit,
    Push,
    PutBack,
    SafeTorqueOff,
    ShiftedTracker,
)
from tonus.sim.devices.cia402.drive import Cia402Drive
from tonus.sim.devices.tracker import Tracker
from tonus.sim.errors import LabError
from tonus.sim.plant import Plant

_Ender = Callable[[], None]


def place(fault: OfRobot) -> tuple[object, ...]:
    """Where it is: a later one of its kind at the same place replaces it."""
    return (fault.kind, getattr(fault, "axis", None), getattr(fault, "cell", None))


class RobotFaults:
    """What is wrong with one robot and its tracker on purpose, whatever bus they are on."""

    def __init__(
        self, robot: Robot, plant: Plant, tracker: Tracker, drives: Sequence[Cia402Drive]
    ) -> None:
        self._robot = robot
        self._plant = plant
        self._tracker = tracker
        self._drives = drives
        self._torque_off: set[int | None] = set()
        """axes whose torque a fault holds off; None: every axis"""

    def places(self, kind: str, *, axis: bool, cell: bool) -> list[str]:
        """Where a kind of fault can happen here; ``axis`` and ``cell`` say what it names."""
        if kind == "brake_weak":
            return [str(axis) for axis in self._braked]
        if axis or cell:
            count = self._robot.cables if axis else self._robot.cells
            return [str(number) for number in range(count)]
        if kind == "phantom_hit":
            return ["phantom"] if self._plant.has_phantom else []
        return ["tracker"] if kind.startswith("tracker") else ["platform"]

    def check(self, fault: OfRobot) -> None:
        """Raises `LabError` if this robot cannot have the fault."""
        for name, count in (("axis", self._robot.cables), ("cell", self._robot.cells)):
            number = getattr(fault, name, None)
            if number is not None and number >= count:
                raise LabError(
                    f"fault {fault.kind}: there is no {name} {number}; there are 0 to {count - 1}"
                )
        if isinstance(fault, BrakeWeak) and fault.axis not in self._braked:
            raise LabError(
                f"fault {fault.kind}: axis {fault.axis} has no holding brake; give the robot one "
                "in robot: brake:"
            )
        if isinstance(fault, PhantomHit) and not self._plant.has_phantom:
            raise LabError(
                f"fault {fault.kind}: this scenario has no phantom; give it one in lab: phantom:"
            )

    @property
    def _braked(self) -> list[int]:
        trains = self._robot.drive_trains
        return [axis for axis, train in enumerate(trains) if train.brake is not None]

    def strike(self, fault: OfRobot, now_ns: int) -> _Ender | None:
        """Make it happen; returns what ends it if it lasts."""
        self._plant.advance(now_ns)
        defects = self._plant.defects
        if isinstance(fault, CableCut):
            self._plant.cut_cable(fault.axis)
        elif isinstance(fault, DrumSlip):
            defects.slip_drum(fault.axis, fault.length, fault.duration)
        elif isinstance(fault, EncoderSlip):
            defects.slip_encoder(fault.axis, fault.angle, fault.over)
        elif isinstance(fault, DrumJam):
            return defects.jam_drum(fault.axis)
        elif isinstance(fault, DrumFriction):
            return defects.rub_drum(fault.axis, fault.force, fault.over)
        elif isinstance(fault, MotorWeak):
            return defects.weaken_motor(fault.axis, fault.gain)
        elif isinstance(fault, BrakeWeak):
            return defects.weaken_brake(fault.axis, fault.gain)
        elif isinstance(fault, SafeTorqueOff):
            return self._take_torque(fault.axis)
        elif isinstance(fault, CellGain):
            return defects.scale_cell(fault.cell, fault.gain, fault.over)
        elif isinstance(fault, CellOffset):
            return defects.offset_cell(fault.cell, fault.force, fault.over)
        elif isinstance(fault, CellFrozen):
            return defects.freeze_cell(fault.cell)
        elif isinstance(fault, EncoderFrozen):
            return defects.freeze_encoder(fault.axis)
        elif isinstance(fault, PhantomHit):
            return defects.hit(fault.distance, fault.speed)
        elif isinstance(fault, Push):
            return defects.push(fault.force, fault.point, fault.rise)
        elif isinstance(fault, PutBack):
            self._plant.put_back()
        elif isinstance(fault, ShiftedTracker):
            return self._shift_tracker(fault)
        else:
            return self._hide()
        return None

    def _take_torque(self, axis: int | None) -> _Ender:
        off = self._torque_off

        def switch() -> None:
            for each in range(len(self._drives)) if axis is None else (axis,):
                self._drives[each].set_input("sto", not off.isdisjoint((None, each)))

        def give_back() -> None:
            off.discard(axis)
            switch()

        off.add(axis)
        switch()
        return give_back

    def _shift_tracker(self, fault: ShiftedTracker) -> _Ender:
        self._tracker.shift[:] = fault.shift

        def put_back() -> None:
            self._tracker.shift[:] = 0.0

        return put_back

    def _hide(self) -> _Ender:
        self._tracker.blocked = True

        def show() -> None:
            self._tracker.blocked = False

        return show
