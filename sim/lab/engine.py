"""The lab: plant, devices, buses, tracker and script, brought forward together in time.

Nothing here runs by itself. Whoever touches the lab first calls `Lab.advance` with the present
time; then everything that was to happen by then happens, in the order of time.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from heapq import heappop, heappush
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.bus import FieldbusSection
from tonus.config.schema.faults import Fault, Replug, Unplug
from tonus.config.schema.lab import LabScript, Load, Phantom
from tonus.config.schema.root import Config
from tonus.sim.can import registry
from tonus.sim.can.canopen.node import Node
from tonus.sim.can.canopen.sync_plan import Reaction
from tonus.sim.can.wire.channel import NEVER
from tonus.sim.can.wire.faulty import FaultyChannel
from tonus.sim.can.wire.latency import Latency
from tonus.sim.can.wire.regular import DELIVERED, WireTable
from tonus.sim.can.wire.timing import LONGEST_FRAME_BITS
from tonus.sim.devices.cia402.drive import Cia402Drive
from tonus.sim.devices.force_cell import ForceCell
from tonus.sim.devices.samples import Samples
from tonus.sim.devices.timers import Callback
from tonus.sim.devices.tracker import Tracker
from tonus.sim.errors import LabError
from tonus.sim.ethercat.segment import Segment
from tonus.sim.lab.build import build
from tonus.sim.lab.direct import DirectPort
from tonus.sim.lab.faults import ActiveFault, Faults
from tonus.sim.lab.robot_faults import RobotFaults
from tonus.sim.lab.statistics import PERIOD_NS, LoadWindow, Statistics, channel_statistics
from tonus.sim.lab.truth import truth_dtype, words
from tonus.sim.plant import Plant
from tonus.sim.plant.parameters import clearance

TRUTH_PERIOD_NS = 1_000_000
_SECOND_NS = 1_000_000_000
Clock = Callable[[], int]
TruthSink = Callable[[NDArray[Any], int], None]


class TrackerFeed:
    """The tracker as a source of datagrams that have arrived."""

    def __init__(self, lab: Lab, tracker: Tracker) -> None:
        self._lab = lab
        self._tracker = tracker

    @property
    def blocked(self) -> bool:
        """The platform is hidden from the tracker."""
        return self._tracker.blocked

    @blocked.setter
    def blocked(self, blocked: bool) -> None:
        self._tracker.blocked = blocked

    def poll(self, now_ns: int) -> list[bytes]:
        self._lab.advance(now_ns)
        return self._tracker.poll(now_ns)

    def close(self) -> None:
        """Nothing is held."""


class Lab:
    """The lab: emulated devices on the buses of ``config``, and the model of the robot.

    ``clock`` returns ns; lab time is its time. ``truth`` is called with the truth record (a
    preallocated array of one, to be copied) and its time, once per millisecond from ``start_ns``.
    Load and faults of ``script`` begin when all drives are first enabled, the load anew at each
    later time. ``seed`` replaces the
    configuration's. ``nodes`` (channel, node id) are the emulated ones, None: all; axes whose
    drives are not emulated have no power, and the script does not wait for them. Raises `LabError`
    without a lab section or with a fault that is not possible in this lab.
    """

    def __init__(
        self,
        config: Config,
        script: LabScript,
        *,
        seed: int,
        clock: Clock,
        truth: TruthSink | None = None,
        start_ns: int = 0,
        nodes: frozenset[tuple[str, int]] | None = None,
    ) -> None:
        if config.lab is None:
            raise LabError(f"configuration {config.name} has no lab section")
        lab = config.lab
        self.clock = clock
        self.seed = seed
        self.now_ns = start_ns
        """time up to which the lab is simulated"""
        self.start_ns = start_ns
        self.plant = Plant(
            config.robot,
            lab,
            seed=seed,
            phantom=script.phantom or lab.phantom,
            load=script.load,
            displacement=script.displacement,
            start_ns=start_ns,
        )
        self.samples = Samples(self.plant, config.robot, lab.noise.force_cell, seed)
        self._timers: list[tuple[int, int, Callback]] = []
        self._timer_count = 0
        self._truth = truth
        self._record = np.zeros(1, truth_dtype(config.robot.cables))
        self._record_words = words(self._record)
        self._grid_ns = start_ns
        self._script = script
        self._load_release = lab.load_release
        self._loaded = True
        self.script_start_ns: int | None = None
        """when the script began; None: it has not"""
        self._tracker = Tracker(
            config.tracker, lab.noise.tracker, self.plant, seed, lab.robot_seeded(seed)
        )
        self.tracker = TrackerFeed(self, self._tracker)
        self._order: list[FaultyChannel] = []
        self._reaction = Reaction(self.samples)
        built = build(self, config, nodes, self._rewire)
        self.channels: dict[str, FaultyChannel] = built.channels
        self.nodes: dict[tuple[str, int], Node] = built.nodes
        self.segments: dict[str, Segment] = built.segments
        """EtherCAT segments, by the name of the master's interface"""
        self.drives: list[Cia402Drive] = built.drives
        self.cells: list[ForceCell] = built.cells
        self._ports = built.ports
        self._bitrate = built.bitrate
        self._awaited = built.awaited
        self._robot_faults = RobotFaults(config.robot, self.plant, self._tracker, self.drives)
        self._faults = Faults(
            self.channels, self.nodes, self.segments, self._robot_faults, self, seed
        )
        for fault in script.faults:
            self._faults.check(fault)
        self.direct = DirectPort(self, config.fieldbus.force_cell)
        self._rewire()
        self._windows = {
            name: LoadWindow(channel, start_ns) for name, channel in self.channels.items()
        }
        if self._windows:
            self.call_at(start_ns + PERIOD_NS, self._note_load)
        for node in self.nodes.values():
            node.boot()

    # -- access ----------------------------------------------------------------------------------

    def port(self, bus: FieldbusSection) -> object:
        """What the emulation of a bus left for its driver in this process; None for nothing."""
        return next((port for theirs, port in self._ports if theirs == bus), None)

    def open(self) -> None:
        """Make the channels available to python-can in this process, by name. Raises `LabError`."""
        for name, channel in self.channels.items():
            registry.enter(name, registry.Door(self, channel, self._bitrate))

    def close(self) -> None:
        """Remove the channels that `open` made available."""
        for name, channel in self.channels.items():
            door = registry.find(name)
            if door is not None and door.channel is channel:
                registry.leave(name)

    def unplug(self, channel: str, node: int) -> None:
        """Disconnect a node from its bus. Raises `LabError`."""
        self.inject(Unplug(kind="unplug", channel=channel, node=node))

    def replug(self, channel: str, node: int) -> None:
        """Connect a node again. Raises `LabError`."""
        self.inject(Replug(kind="replug", channel=channel, node=node))

    def load(self, channel: str) -> float:
        """Share of the time since the start in which a channel was busy, spaces included."""
        passed = self.now_ns - self.start_ns
        return self.channels[channel].busy_ns / passed if passed else 0.0

    def measure_latency(self, *, on: bool = True) -> None:
        """Start (again) or end the measurement of the frames' latencies."""
        for channel in self.channels.values():
            channel.latency = Latency() if on else None

    def statistics(self) -> Statistics:
        """Frames and load of the channels up to now."""
        return Statistics(
            time=(self.now_ns - self.start_ns) / _SECOND_NS,
            channels={
                name: channel_statistics(channel, self._windows[name], self.start_ns, self.now_ns)
                for name, channel in self.channels.items()
            },
        )

    def _note_load(self, now_ns: int) -> None:
        for window in self._windows.values():
            window.note(now_ns)
        self.call_at(now_ns + PERIOD_NS, self._note_load)

    def _rewire(self) -> None:
        """All wires, those of controllers that are cut off included."""
        self._order[:] = [
            wire for channel in self.channels.values() for wire in (channel, *channel.severed)
        ]
        self._table = WireTable(len(self._order), LONGEST_FRAME_BITS + 1)
        for row, channel in enumerate(self._order):
            channel.wire.move(self._table, row)

    # -- time ------------------------------------------------------------------------------------

    def call_at(self, at_ns: int, callback: Callback) -> None:
        """Call in the order of time, equal times in the order of these calls."""
        self._timer_count += 1
        heappush(self._timers, (at_ns, self._timer_count, callback))

    def next_event_ns(self) -> int:
        """A time (ns) not later than the next event that is visible outside the lab.

        The truth record's millisecond does not count: it can be computed later.
        """
        due = min(channel.next_ns() for channel in self._order) if self._order else NEVER
        if self._timers:
            due = min(due, self._timers[0][0])
        arrival = self._tracker.next_arrival_ns
        return min(due, self._tracker.next_ns if arrival is None else arrival)

    def next_work_ns(self) -> int:
        """The next event that is not a channel's own, the truth record's millisecond included."""
        due = self._grid_ns
        if self._tracker.next_ns < due:
            due = self._tracker.next_ns
        if self._timers and self._timers[0][0] < due:
            due = self._timers[0][0]
        return due

    def advance(self, to_ns: int) -> None:
        """Simulate up to ``to_ns``, in order of time over all channels, and let every host have
        what has come for it. An earlier time brings nothing forward."""
        self.simulate(to_ns)
        for channel in self._order:
            if channel.wire.words[DELIVERED]:
                channel.hand_out()

    def simulate(self, to_ns: int) -> None:
        """`advance`, but hosts may have to wait for their frames until the next one: for a time at
        which nobody looks for them."""
        if to_ns <= self.now_ns:
            return
        channels = self._order
        while True:
            due = self.next_work_ns()
            if channels:
                self._carry(min(due, to_ns))
                due = self.next_work_ns()
            if due > to_ns:
                break
            self.now_ns = due
            self._happen(due)
        self.now_ns = to_ns

    def _carry(self, limit: int) -> None:
        """Let frames come up to ``limit``, or to a timer that one of them has set before it."""
        channels = self._order
        row = self._table.run(0, limit)
        while row < len(channels):
            channels[row].run(limit)
            row = self._table.run(row + 1, limit)
        while True:
            row, when = self._table.waiting()
            if when > limit:
                break
            self.now_ns = when
            left = None
            if channels[row].ready:
                row, left = self._reaction(self._table, when, limit)
                if row == len(channels):
                    continue
            channel = channels[row]
            if left is None:
                channel.deliver()
            else:
                channel.follow(left, when)
            # The frame may have set a timer before the limit.
            if self._timers and self._timers[0][0] < limit:
                limit = self._timers[0][0]
            channel.run(limit)

    def _happen(self, now_ns: int) -> None:
        """Timers, exposure and truth of one instant."""
        timers = self._timers
        while timers and timers[0][0] <= now_ns:
            heappop(timers)[2](now_ns)
        if self._tracker.next_ns == now_ns:
            self.plant.advance(now_ns)
            self._tracker.expose(now_ns)
        if self._grid_ns == now_ns:
            self._grid_ns = now_ns + TRUTH_PERIOD_NS
            self.plant.advance(now_ns)
            if self.script_start_ns is None:
                self._start_script(now_ns)
            elif self._script.load is not None and self._awaited:
                self._follow_power(self._script.load, now_ns)
            if self._truth is not None:
                self._record_words[:] = self.plant.truth
                self._truth(self._record, now_ns)

    # -- script ----------------------------------------------------------------------------------

    def _start_script(self, now_ns: int) -> None:
        for drive in self._awaited:
            if not drive.enabled:
                return
        self.script_start_ns = now_ns
        self.plant.start_schedule(now_ns)
        script = self._script
        self._tracker.start_script(now_ns, script.occlusions, script.tracker_shifts)
        for fault in self._script.faults:
            self._inject_later(fault, now_ns)

    def _follow_power(self, load: Load, now_ns: int) -> None:
        """A load that has not begun waits while no drive is enabled; one that pulls goes on. Once
        all drives are enabled again it begins anew."""
        if self._loaded:
            if not any(drive.enabled for drive in self._awaited):
                self._loaded = False
                self.plant.withhold()
        elif all(drive.enabled for drive in self._awaited):
            self._loaded = True
            self.plant.schedule(load)
            self.plant.start_schedule(now_ns)

    def release_load(self) -> None:
        """Have the script's load or displacement end now: who applies it sees the robot stop."""
        self.plant.release(self._load_release)

    def extend_script(self, faults: Collection[Fault]) -> None:
        """Add faults as if the script had contained them from the start. Raises `LabError` before
        the script has begun, and for a fault that would be due already."""
        begun = self.script_start_ns
        if begun is None:
            raise LabError("the script has not begun: not every drive has been enabled")
        for fault in faults:
            self._faults.check(fault)
            if begun + round(fault.at * _SECOND_NS) <= self.now_ns:
                raise LabError(f"fault {fault.kind}: {fault.at:g} s of the script are over")
        for fault in faults:
            self._inject_later(fault, begun)

    def extend_load(self, load: Load) -> None:
        """Have the load port play ``load`` as if the script, which has none, had contained it from
        the start. Raises `LabError` for one that would have begun by now."""
        begun, first = self.script_start_ns, load.profile[0]
        played = begun is not None and begun + round(first.at * _SECOND_NS) < self.now_ns
        if played or first.force:
            raise LabError("the load would have begun already")
        self.plant.schedule(load)

    def extend_phantom(self, phantom: Phantom) -> None:
        """Add a phantom that has not been touched yet, as if the script had contained it from the
        start. Raises `LabError` where there is one, or where the contact port is in it."""
        if self.plant.has_phantom:
            raise LabError("there is a phantom already")
        if clearance(phantom, self.plant.position[None])[0] <= 0.0:
            raise LabError("the platform is in the phantom already")
        self.plant.add_phantom(phantom)

    def inject(self, fault: Fault) -> None:
        """Inject a fault now, or ``fault.at`` s from now. Raises `LabError` if it is not possible
        in this lab."""
        self._faults.check(fault)
        if fault.at:
            self._inject_later(fault, self.now_ns)
        else:
            self._faults.inject(fault)

    def _inject_later(self, fault: Fault, from_ns: int) -> None:
        at_ns = from_ns + round(fault.at * _SECOND_NS)
        self.call_at(at_ns, lambda _: self._faults.inject(fault))

    def robot_places(self, kind: str, *, axis: bool, cell: bool) -> list[str]:
        """Axes or cells where a kind of fault of the robot is possible; see
        `tonus.sim.lab.robot_faults`."""
        return self._robot_faults.places(kind, axis=axis, cell=cell)

    def faults(self) -> list[ActiveFault]:
        """The active faults, oldest first."""
        return self._faults.active()
