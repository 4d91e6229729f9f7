"""The lab's door on its EtherCAT segments: plain orders to frames and slaves, and their states.

``slave`` counts from 0 along the cable, as an EtherCAT master's list of slaves does; ``channel``
names a segment and may be left out where there is one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal, Protocol, get_args

from pydantic import Field

from tonus.config.schema.base import Fraction, Section
from tonus.config.schema.faults import Babble, StuckBus
from tonus.sim.devices.cia402.drive import Cia402Drive
from tonus.sim.errors import LabError
from tonus.sim.ethercat.faults import ONLY_HERE
from tonus.sim.ethercat.segment import Segment
from tonus.sim.ethercat.slaves.slave import Slave
from tonus.sim.ethercat.slaves.states import State

Reply = dict[str, Any]
_Whole = Annotated[int, Field(ge=0)]
_Code = Annotated[int, Field(ge=0, le=0xFFFF)]
_StateNumber = Annotated[int, Field(ge=1, le=8)]


class _Clock(Protocol):
    @property
    def now_ns(self) -> int: ...


class FrameOrders(Section):
    """What happens to frames; what is left out stays as it is."""

    drop: _Whole | None = None
    """frames that are lost next"""
    drop_p: Fraction | None = None
    """probability with which any is"""
    mute: bool | None = None
    """whether all are"""
    drop_mbx: _Whole | None = None
    """answers to reads of a mailbox that are lost next"""
    drop_mbxw: _Whole | None = None
    """answers to writes of a mailbox that are lost next"""


class _Order(Section):
    channel: str | None = None


class _Frames(_Order):
    op: Literal["fault"]
    f: FrameOrders


class _OfSlave(_Order):
    slave: _Whole


class _Al(_OfSlave):
    op: Literal["al"]
    state: _StateNumber
    code: _Code = 0


class _Reject(_OfSlave):
    op: Literal["reject"]
    map: dict[_StateNumber, _Code]
    """AL status code for each state that is refused; empty: none is"""


class _Cut(_Order):
    op: Literal["cut"]
    n: _Whole
    """so many slaves answer; as many as there are: all do"""


class _DriveFault(_OfSlave):
    op: Literal["drive_fault"]
    code: Annotated[int, Field(ge=1, le=0xFFFF)]


Verbs = dict[str, tuple[type[Section], Callable[[Any], Reply]]]


def of(found: Mapping[str, Segment], clock: _Clock) -> Verbs:
    """The verbs of a lab's door that its segments answer to."""

    def segment(order: _Order) -> Segment:
        if order.channel is None:
            return next(iter(found.values()))
        if order.channel not in found:
            raise LabError(f"there is no segment {order.channel!r}; there is {', '.join(found)}")
        return found[order.channel]

    def slave(order: _OfSlave) -> Slave:
        there = segment(order).slaves
        if order.slave >= len(there):
            raise LabError(f"there is no slave {order.slave}; there are 0 to {len(there) - 1}")
        return there[order.slave]

    def frames(order: _Frames) -> Reply:
        disturbance = segment(order).disturbance
        for name, value in order.f.model_dump(exclude_none=True).items():
            setattr(disturbance, name, value)
        disturbance.changed()
        return {"f": orders(segment(order))}

    def al(order: _Al) -> Reply:
        if order.state not in State._value2member_map_:
            raise LabError(f"there is no state {order.state}; there are 1, 2, 4 and 8")
        slave(order).force(State(order.state), order.code, clock.now_ns)
        return {}

    def reject(order: _Reject) -> Reply:
        slave(order).rejects = dict(order.map)
        return {}

    def cut(order: _Cut) -> Reply:
        one = segment(order)
        one.cable.mend()
        if order.n < len(one.slaves):
            one.cable.cut(order.n)
        return {}

    def drive_fault(order: _DriveFault) -> Reply:
        device = slave(order).device
        if not isinstance(device, Cia402Drive):
            raise LabError(f"slave {order.slave} is not a drive")
        if order.code not in device.errors:
            raise LabError(f"a drive has no error 0x{order.code:04X}")
        device.fail(order.code)
        return {}

    return {
        "fault": (_Frames, frames),
        "al": (_Al, al),
        "reject": (_Reject, reject),
        "cut": (_Cut, cut),
        "drive_fault": (_DriveFault, drive_fault),
    }


def orders(segment: Segment) -> Reply:
    """The orders to frames that are at work."""
    disturbance = segment.disturbance
    return {name: getattr(disturbance, name) for name in FrameOrders.model_fields}


def segments(found: Mapping[str, Segment]) -> Reply:
    """What each segment has carried."""
    return {
        name: {**vars(segment.counts), "slaves": len(segment.slaves), "f": orders(segment)}
        for name, segment in found.items()
    }


def slaves(found: Mapping[str, Segment]) -> list[Reply]:
    """State, error flag and code of every slave, and what is behind it."""
    return [
        _told(segment, place, slave)
        for segment in found.values()
        for place, slave in enumerate(segment.slaves)
    ]


def _told(segment: Segment, place: int, slave: Slave) -> Reply:
    device, standing = slave.device, slave.standing
    told: Reply = {
        "channel": segment.name,
        "slave": place,
        "name": slave.kind.name,
        "state": int(standing.state),
        "state_name": standing.state.name,
        "error": standing.error,
        "code": standing.code,
        "reachable": segment.cable.reachable(place),
        "powered": slave.powered,
        "clock_difference_ns": slave.clock.difference,
        "sync_pulses": slave.sync.pulses,
    }
    if isinstance(device, Cia402Drive):
        told |= {
            "device": f"axis {device.axis}",
            "drive_state": device.state.name,
            "drive_error": device.objects.number(0x603F, 0),
        }
    else:
        cells = getattr(device, "cells", ())
        told |= {"device": f"cell {' '.join(map(str, cells))}"}
    return told


def _names(models: tuple[type[Section], ...]) -> frozenset[str]:
    return frozenset(get_args(model.model_fields["kind"].annotation)[0] for model in models)


_ETHERCAT_KINDS = _names(get_args(ONLY_HERE))
_CAN_KINDS = _names((Babble, StuckBus))


def possible(kind: str) -> tuple[bool, bool]:
    """Whether a kind of fault can happen on CAN, and on EtherCAT."""
    return kind not in _ETHERCAT_KINDS, kind not in _CAN_KINDS
