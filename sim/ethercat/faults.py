"""The schema's faults on an EtherCAT segment: whether it can have them, and what they do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from tonus.config.schema.faults import (
    Babble,
    CableBreak,
    CellBreak,
    ClearFaults,
    ClockDrift,
    Corruption,
    Delay,
    Disconnect,
    DriveError,
    DriveInput,
    Duplicate,
    Fault,
    Loss,
    MailboxAbort,
    PowerCycle,
    PowerLoss,
    Replug,
    StateDrop,
    StateRefusal,
    StuckBus,
    Unplug,
    WatchdogExpiry,
    WrongIdentity,
)
from tonus.config.schema.robot_faults import OfRobot
from tonus.sim.devices.cia402.drive import Cia402Drive
from tonus.sim.devices.force_cell import ForceCell
from tonus.sim.errors import LabError
from tonus.sim.ethercat.disturbance import Draws, Played
from tonus.sim.ethercat.segment import Segment
from tonus.sim.ethercat.slaves.slave import Slave
from tonus.sim.ethercat.slaves.states import State

ONLY_HERE = (
    PowerLoss
    | CableBreak
    | WrongIdentity
    | StateDrop
    | StateRefusal
    | MailboxAbort
    | WatchdogExpiry
    | ClockDrift
)
_OF_FRAMES = Loss | Corruption | Delay | Duplicate
_OF_CAN = Babble | StuckBus
STATES = {
    "init": State.INIT,
    "pre_op": State.PRE_OP,
    "safe_op": State.SAFE_OP,
    "op": State.OP,
}
_PPM = 1e-6
_Ender = Callable[[], None]
SegmentFault = Any
"""A fault with a channel: any but `ClearFaults` and those of the robot."""


class Spawning(Draws, Protocol):
    """A stream that has streams of its own; numpy's generators have."""

    def spawn(self, n_children: int) -> list[Any]: ...


def check(segment: Segment, fault: Fault) -> None:
    """Raises `LabError` if the segment cannot have the fault."""
    assert not isinstance(fault, ClearFaults | OfRobot)
    what = f"fault {fault.kind}"
    if isinstance(fault, _OF_CAN):
        raise LabError(f"{what}: {fault.channel} is an EtherCAT segment; only CAN has that")
    if isinstance(fault, _OF_FRAMES):
        if fault.identifier is not None:
            raise LabError(f"{what}: frames of EtherCAT have no identifier; leave it out")
        return
    count = len(segment.slaves)
    if isinstance(fault, Disconnect):
        return
    if isinstance(fault, CableBreak):
        if fault.behind >= count + segment.cable.ring:
            most = f"at most the {count}" if segment.cable.ring else f"less than the {count}"
            raise LabError(f"{what}: behind must be {most} slaves there are")
        return
    if fault.node > count:
        raise LabError(
            f"{what}: there is no slave {fault.node} on {segment.name}; there are {count}"
        )
    device = segment.slaves[fault.node - 1].device
    where = f"{what}: slave {fault.node} on {segment.name}"
    if isinstance(fault, DriveError | DriveInput) and not isinstance(device, Cia402Drive):
        raise LabError(f"{where} is not a drive")
    if isinstance(fault, DriveError) and fault.code not in getattr(device, "errors", ()):
        raise LabError(f"{what}: a drive has no error 0x{fault.code:04X}")
    if isinstance(fault, CellBreak) and not isinstance(device, ForceCell):
        raise LabError(f"{where} is not a load cell")


def undone_by(fault: SegmentFault) -> tuple[type[Any], ...]:
    """Lasting kinds that end, at the same place, when this one begins."""
    if isinstance(fault, Replug | Unplug):
        return (Unplug,)
    if isinstance(fault, PowerCycle | PowerLoss):
        return (PowerLoss,)
    if isinstance(fault, CellBreak | WrongIdentity | ClockDrift | Disconnect | CableBreak):
        return (type(fault),)
    return ()


def strike(
    segment: Segment, fault: SegmentFault, draws: Spawning, now_ns: int
) -> tuple[_Ender | None, Played | None]:
    """Make it happen; what ends it if it lasts, and what counts its frames. Raises `LabError`."""
    if isinstance(fault, _OF_FRAMES):
        played = Played(fault, draws.spawn(1)[0])
        segment.disturbance.add(played)
        return lambda: segment.disturbance.remove(played), played
    if isinstance(fault, Disconnect):
        return _break(segment, 0), None
    if isinstance(fault, CableBreak):
        return _break(segment, fault.behind), None
    place = fault.node - 1
    if isinstance(fault, Unplug):
        return _break(segment, place), None
    if isinstance(fault, PowerLoss):
        segment.cable.switch(place, on=False)
        return lambda: segment.cable.switch(place, on=True), None
    if isinstance(fault, PowerCycle):
        segment.cable.switch(place, on=False)
        segment.cable.switch(place, on=True)
        return None, None
    return _strike_slave(segment.slaves[place], fault, now_ns), None


def _break(segment: Segment, place: int) -> _Ender:
    segment.cable.cut(place)
    return lambda: segment.cable.mend(place)


def _strike_slave(slave: Slave, fault: SegmentFault, now_ns: int) -> _Ender | None:
    device: Any = slave.device
    if isinstance(fault, DriveError):
        device.fail(fault.code)
    elif isinstance(fault, DriveInput):
        device.set_input(fault.input, fault.active)
        return (lambda: device.set_input(fault.input, False)) if fault.active else None
    elif isinstance(fault, CellBreak):
        device.break_sensor(broken=fault.broken)
        return (lambda: device.break_sensor(broken=False)) if fault.broken else None
    elif isinstance(fault, WrongIdentity):
        slave.set_identity(fault.vendor, fault.product, fault.revision)
        kind = slave.kind
        return lambda: slave.set_identity(kind.vendor, kind.product, kind.revision)
    elif isinstance(fault, StateDrop):
        slave.force(STATES[fault.state], fault.code, now_ns)
    elif isinstance(fault, StateRefusal):
        slave.rejects[STATES[fault.state]] = fault.code
        return lambda: _accept(slave, STATES[fault.state])
    elif isinstance(fault, MailboxAbort):
        slave.aborts[fault.index, fault.subindex] = [fault.code, fault.times]
        return None
    elif isinstance(fault, WatchdogExpiry):
        slave.expire(now_ns)
    elif isinstance(fault, ClockDrift):
        before = slave.clock.drift
        slave.set_drift(fault.drift_ppm * _PPM)
        return lambda: slave.set_drift(before)
    return None


def _accept(slave: Slave, state: State) -> None:
    slave.rejects.pop(state, None)
