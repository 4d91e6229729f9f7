"""The faults a lab is asked for: whether it can have them, what they do, and how they end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol, TypedDict

from tonus.config.schema.faults import (
    Babble,
    CellBreak,
    ClearFaults,
    Corruption,
    Delay,
    Disconnect,
    DriveError,
    DriveInput,
    Duplicate,
    Fault,
    Loss,
    PowerCycle,
    Replug,
    StuckBus,
    Unplug,
)
from tonus.config.schema.robot_faults import OfRobot
from tonus.sim.can.canopen.node import Node
from tonus.sim.can.wire.faulty import FaultyChannel
from tonus.sim.can.wire.frame_faults import FrameFault
from tonus.sim.devices.cia402.drive import Cia402Drive
from tonus.sim.devices.force_cell import ForceCell
from tonus.sim.devices.timers import Timers
from tonus.sim.errors import LabError
from tonus.sim.ethercat import faults as ethercat
from tonus.sim.ethercat.segment import Segment
from tonus.sim.lab.robot_faults import RobotFaults, place
from tonus.sim.plant.streams import Stream, generator

_SECOND_NS = 1_000_000_000
_OF_NODE = Unplug | Replug | PowerCycle | DriveError | DriveInput | CellBreak
_OF_FRAMES = Loss | Corruption | Delay | Duplicate
_OF_CHANNEL = _OF_FRAMES | Babble | StuckBus | Disconnect
_Ender = Callable[[], None]


class ActiveFault(TypedDict):
    """A lasting fault: its fields, and the lab's time in s at which it began."""

    fault: dict[str, Any]
    since: float


class _Playing(Protocol):
    @property
    def spent(self) -> bool: ...


class _Lasting:
    def __init__(self, fault: Fault, since_ns: int, end: _Ender, played: _Playing | None) -> None:
        self.fault = fault
        self.since_ns = since_ns
        self.end = end
        self.played = played

    @property
    def over(self) -> bool:
        return self.played is not None and self.played.spent


class Faults:
    """What is wrong with a lab's buses, devices and robot on purpose."""

    def __init__(
        self,
        channels: Mapping[str, FaultyChannel],
        nodes: Mapping[tuple[str, int], Node],
        segments: Mapping[str, Segment],
        robot: RobotFaults,
        timers: Timers,
        seed: int,
    ) -> None:
        self._channels = channels
        self._nodes = nodes
        self._segments = segments
        self._robot = robot
        self._timers = timers
        # Each fault draws from a stream of its own: a channel's faults do not feel another's.
        self._draws = generator(seed, Stream.FAULTS)
        self._start_ns = timers.now_ns
        self._lasting: list[_Lasting] = []

    # -- whether ---------------------------------------------------------------------------------

    def check(self, fault: Fault) -> None:
        """Raises `LabError` if this lab cannot have the fault."""
        if isinstance(fault, OfRobot):
            self._robot.check(fault)
            return
        segment = self._segments.get(fault.channel or "")
        if isinstance(fault, ClearFaults):
            if fault.channel is not None and segment is None:
                self._channel(fault.channel)
        elif segment is not None:
            ethercat.check(segment, fault)
        elif isinstance(fault, ethercat.ONLY_HERE):
            self._channel(fault.channel)
            raise LabError(
                f"fault {fault.kind}: {fault.channel} is a CAN channel; this kind "
                "does not exist on CAN"
            )
        elif isinstance(fault, _OF_CHANNEL):
            self._channel(fault.channel)
        else:
            self._check_node(fault)

    def _check_node(self, fault: _OF_NODE) -> None:
        node = self._node(fault.channel, fault.node)
        what = f"fault {fault.kind}: node {fault.node} on {fault.channel}"
        device = node.device
        if isinstance(fault, DriveError | DriveInput) and not isinstance(device, Cia402Drive):
            raise LabError(f"{what} is not a drive")
        if isinstance(fault, DriveError) and fault.code not in getattr(device, "errors", ()):
            raise LabError(f"fault {fault.kind}: a drive has no error 0x{fault.code:04X}")
        if isinstance(fault, DriveInput) and not hasattr(node.device, "set_input"):
            raise LabError(f"{what} has no input {fault.input}")
        if isinstance(fault, PowerCycle) and not hasattr(node.device, "power_cycle"):
            raise LabError(f"{what} has no supply to interrupt")
        if isinstance(fault, CellBreak) and not isinstance(node.device, ForceCell):
            raise LabError(f"{what} is not a load cell")

    def _channel(self, name: str) -> FaultyChannel:
        found = self._channels.get(name)
        if found is None:
            known = [*self._channels, *self._segments]
            raise LabError(f"there is no channel {name!r}; there {_list(known)}")
        return found

    def _node(self, channel: str, node: int) -> Node:
        self._channel(channel)
        found = self._nodes.get((channel, node))
        if found is None:
            nodes = [str(number) for name, number in self._nodes if name == channel]
            raise LabError(f"there is no node {node} on channel {channel!r}; there {_list(nodes)}")
        return found

    # -- what ------------------------------------------------------------------------------------

    def inject(self, fault: Fault) -> None:
        """Make it happen now. Raises `LabError`."""
        self.check(fault)
        if isinstance(fault, ClearFaults):
            self._clear(fault.channel)
        elif isinstance(fault, OfRobot):
            self._break_robot(fault)
        elif fault.channel in self._segments:
            self._strike_segment(self._segments[fault.channel], fault)
        elif isinstance(fault, _OF_CHANNEL):
            self._disturb(fault)
        elif not isinstance(fault, ethercat.ONLY_HERE):
            self._strike(fault)

    def _break_robot(self, fault: OfRobot) -> None:
        where = place(fault)
        replaced = [
            item
            for item in self._lasting
            if isinstance(item.fault, OfRobot) and place(item.fault) == where
        ]
        # The new one goes on from what the old one had come to.
        self._lasting = [item for item in self._lasting if item not in replaced]
        end = self._robot.strike(fault, self._timers.now_ns)
        if end is not None:
            self._last(fault, end)

    def _strike_segment(self, segment: Segment, fault: ethercat.SegmentFault) -> None:
        if isinstance(fault, DriveInput):
            self._forget(fault, DriveInput)
        for kind in ethercat.undone_by(fault):
            self._end_same(fault, kind)
        end, played = ethercat.strike(segment, fault, self._draws, self._timers.now_ns)
        if end is not None:
            self._last(fault, end, played)

    def _end_same(self, fault: Any, kind: type[Any]) -> None:
        """End what lasts of this kind at the same place."""
        for item in tuple(self._lasting):
            if isinstance(item.fault, kind) and _place(item.fault) == _place(fault):
                self._end(item)

    def active(self) -> list[ActiveFault]:
        """The lasting faults, oldest first."""
        self._lasting = [item for item in self._lasting if not item.over]
        return [
            ActiveFault(
                fault=item.fault.model_dump(mode="json", exclude_none=True, exclude={"at"}),
                since=(item.since_ns - self._start_ns) / _SECOND_NS,
            )
            for item in self._lasting
        ]

    def _strike(self, fault: _OF_NODE) -> None:
        node = self._node(fault.channel, fault.node)
        device: Any = node.device
        if isinstance(fault, Unplug):
            node.unplug()
            self._last(fault, node.replug)
        elif isinstance(fault, Replug):
            node.replug()
            self._forget(fault, Unplug)
        elif isinstance(fault, PowerCycle):
            node.power_cycle()
        elif isinstance(fault, DriveError):
            device.fail(fault.code)
        elif isinstance(fault, DriveInput):
            device.set_input(fault.input, fault.active)
            self._forget(fault, DriveInput)
            if fault.active:
                self._last(fault, lambda: device.set_input(fault.input, False))
        else:
            device.break_sensor(broken=fault.broken)
            self._forget(fault, CellBreak)
            if fault.broken:
                self._last(fault, lambda: device.break_sensor(broken=False))

    def _disturb(self, fault: _OF_CHANNEL) -> None:
        channel, timers = self._channel(fault.channel), self._timers
        if isinstance(fault, _OF_FRAMES):
            played = FrameFault(fault, self._draws.spawn(1)[0])
            channel.add(played)
            self._last(fault, lambda: channel.remove(played), played)
        elif isinstance(fault, Babble):
            port = channel.babble(fault, timers.now_ns)
            self._last(fault, lambda: channel.hush(port))
        elif isinstance(fault, StuckBus):
            self._end_others(fault)
            channel.jam(fault.level, timers.now_ns)
            self._last(fault, lambda: channel.release(timers.now_ns))
        else:
            self._end_others(fault)
            channel.cut(timers.now_ns)
            self._last(fault, lambda: channel.mend(timers.now_ns))

    # -- how it ends -----------------------------------------------------------------------------

    def _last(self, fault: Fault, end: _Ender, played: _Playing | None = None) -> None:
        now_ns = self._timers.now_ns
        item = _Lasting(fault, now_ns, end, played)
        self._lasting.append(item)
        duration = getattr(fault, "duration", None)
        if duration is not None:
            at_ns = now_ns + round(duration * _SECOND_NS)
            self._timers.call_at(at_ns, lambda _: self._end(item))

    def _end(self, item: _Lasting) -> None:
        if item in self._lasting:
            self._lasting.remove(item)
            item.end()

    def _clear(self, channel: str | None) -> None:
        for item in tuple(self._lasting):
            if channel is None or getattr(item.fault, "channel", None) == channel:
                self._end(item)

    def _end_others(self, fault: StuckBus | Disconnect) -> None:
        """A bus is stuck once, and cut once: the new one replaces the old."""
        for item in tuple(self._lasting):
            if isinstance(item.fault, type(fault)) and item.fault.channel == fault.channel:
                self._end(item)

    def _forget(self, fault: _OF_NODE, kind: type[_OF_NODE]) -> None:
        """A later fault has undone or replaced what lasted."""
        self._lasting = [
            item
            for item in self._lasting
            if not (isinstance(item.fault, kind) and _place(item.fault) == _place(fault))
        ]


def _place(fault: Any) -> tuple[object, ...]:
    named = ("node", "behind", "input")
    return (fault.channel, *(getattr(fault, name, None) for name in named))


def _list(names: Mapping[str, object] | list[str]) -> str:
    return "are " + ", ".join(names) if names else "is none"
