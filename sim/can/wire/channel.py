"""One CAN channel in time: queues, arbitration, one frame at a time, delivery.

Here every frame is sound and acknowledged; `tonus.sim.can.wire.faulty` adds what happens to others.
A channel knows no clock. `run` brings it to a given time and stops early where a frame reaches a
receiver whose answer may concern others (a SYNC samples the plant, which all channels share): that
frame waits in ``wide_ns`` until the lab delivers it in the order of time over all channels.
Everything else, which is most of the traffic, stays within the channel and is done at once.

Rules of time: a frame enters its queue before the arbitration of the same instant, and an
arbitration is decided only when time has moved past it. So it does not matter in which steps the
lab is brought forward.
"""

from __future__ import annotations

from bisect import insort
from collections import deque
from collections.abc import Callable, Iterable
from heapq import heappop, heappush
from math import ceil

from tonus.sim.can.wire import regular
from tonus.sim.can.wire.frame import Frame
from tonus.sim.can.wire.inbox import Inbox, pack
from tonus.sim.can.wire.latency import Latency
from tonus.sim.can.wire.plan import Planner, SyncPlan
from tonus.sim.can.wire.port import Notice, Port
from tonus.sim.can.wire.regular import NEVER, RegularWire
from tonus.sim.can.wire.timing import (
    INTERFRAME_BITS,
    LONGEST_FRAME_BITS,
    frame_bits,
    stuffed_bits,
)

__all__ = ["NEVER"]
_from_bytes = int.from_bytes
_SHORT = 1
"""Bytes up to which a frame's time is kept, for at most so many frames:"""
_KEPT = 256
_SECOND_NS = 1_000_000_000


Narrow = Callable[[Frame], bool]
"""Takes a frame whose effect stays within its receiver; False: it needs the order of time."""
Wide = Callable[[Frame], None]
Detour = Callable[[Port, Frame, int], bool]
"""May keep a frame from its queue; True if it does."""


class Channel:
    """One bus. ``wide_ns`` is the time of a frame that waits for the lab, or `NEVER`."""

    # Slots, because beyond thirty attributes an instance's own dictionary is slow.
    __slots__ = (
        "_all_ports",
        "_arrivals",
        "_bitrate",
        "_busy_ns",
        "_calm",
        "_depth",
        "_durations",
        "_end_ns",
        "_frame",
        "_frames",
        "_free_ns",
        "_gap_ns",
        "_heads",
        "_hosts",
        "_latency",
        "_narrow",
        "_notices",
        "_plan",
        "_planned",
        "_ports",
        "_regular",
        "_short",
        "_since",
        "_wide",
        "detour",
        "name",
        "planner",
        "response_ns",
        "wire",
    )

    def __init__(self, name: str, bitrate: int, queue_depth: int, response_ns: int) -> None:
        """``response_ns`` is how long a device takes until its answer is in its queue."""
        self.name = name
        self._busy_ns = self._frames = 0
        self.planner: Planner | None = None
        self._latency: Latency | None = None
        self.detour: Detour | None = None
        self._bitrate = bitrate
        self._calm = True
        self._depth = queue_depth
        self.response_ns = response_ns
        self._ports = 0
        self._hosts: list[tuple[Port, Inbox]] = []
        self._heads: list[tuple[int, int, Frame, Port]] = []
        self._since = NEVER  # when the oldest queued frame came
        self._arrivals: deque[tuple[int, Frame, Port]] = deque()
        self._frame: Frame | None = None
        self._end_ns = 0
        self._free_ns = 0
        self._narrow: dict[int, list[tuple[Port, Narrow]]] = {}
        self._wide: dict[int, list[tuple[Port, Wide]]] = {}
        # A frame's time by its bits; a table, because this is asked for every frame.
        self._durations = [ceil(n * _SECOND_NS / bitrate) for n in range(LONGEST_FRAME_BITS + 1)]
        self._short: dict[tuple[int, int, bytes], int] = {}
        self._gap_ns = self._durations[INTERFRAME_BITS]
        self._all_ports: list[Port] = []
        self._notices: list[tuple[Port, Notice]] = []
        room = min(queue_depth, regular.ROOM)
        self.wire = RegularWire(self._durations, self._gap_ns, room)
        self._plan: SyncPlan | None = None
        self._planned = False  # whether the plan is that of the present channel
        self._regular = False  # whether the wire is where the frames are

    @property
    def regular(self) -> bool:
        """Whether compiled code has the frames: nothing is there that is not as usual."""
        return self._regular

    @property
    def wide_ns(self) -> int:
        return self.wire.words[regular.WIDE]

    @wide_ns.setter
    def wide_ns(self, wide_ns: int) -> None:
        self.wire.words[regular.WIDE] = wide_ns

    @property
    def busy_ns(self) -> int:
        """Time spent on frames and the spaces behind them, since the start."""
        return self._busy_ns + int(self.wire.state[regular.BUSY])

    @property
    def frames(self) -> int:
        """Frames on the wire since the start."""
        return self._frames + int(self.wire.state[regular.FRAMES])

    @property
    def latency(self) -> Latency | None:
        """Measured while there is one."""
        return self._latency

    @latency.setter
    def latency(self, latency: Latency | None) -> None:
        self._leave()
        self._latency = latency

    @property
    def overflows(self) -> int:
        """Frames lost or refused at a full transmit queue, of all controllers."""
        return sum(port.overflows for port in self._all_ports)

    @property
    def ports(self) -> tuple[Port, ...]:
        """The controllers on the wire."""
        return tuple(self._all_ports)

    def attach(self, *, listens: bool, inbox: int | None = None) -> Port:
        """A new controller; with ``listens`` it receives every frame of the others, and keeps
        ``inbox`` of them at most."""
        port = Port(self, self._ports, self._depth, listens, inbox)
        self._ports += 1
        self._all_ports.append(port)
        if port.received is not None:
            self._hosts.append((port, port.received))
        return port

    def detach(self, port: Port) -> None:
        """Take a controller away, with what it had queued. A frame on the wire is finished."""
        self.drop(port)
        self._all_ports.remove(port)
        self._deafen(port)

    def _deafen(self, port: Port) -> None:
        self._hosts = [host for host in self._hosts if host[0] is not port]

    def drop(self, port: Port) -> None:
        """Forget what a controller has queued or is about to queue."""
        self._leave()
        port.queue.clear()
        self._withdraw(port)
        self._arrivals = deque(item for item in self._arrivals if item[2] is not port)

    def restart(self, port: Port) -> None:
        """Switch a controller on anew."""
        self.drop(port)
        port.overflowing = False

    def _withdraw(self, port: Port) -> None:
        """Take a controller out of the arbitration."""
        self._leave()
        self._heads = sorted(head for head in self._heads if head[3] is not port)
        if not self._heads:
            self._since = NEVER

    def _compete(self, port: Port, now_ns: int) -> None:
        """Let a controller's oldest frame, if it has one, into the arbitration."""
        if port.queue:
            frame = port.queue[0]
            heappush(self._heads, (frame.key, port.number, frame, port))
            self._since = min(self._since, now_ns)

    def subscribe(self, port: Port, identifier: int, wide: Wide, narrow: Narrow | None) -> None:
        """Hand frames of an identifier to a device: to ``narrow`` first where there is one."""
        self._leave()
        self._wide.setdefault(identifier, []).append((port, wide))
        if narrow is not None:
            self._narrow.setdefault(identifier, []).append((port, narrow))

    def unsubscribe(self, port: Port, identifier: int) -> None:
        self._leave()
        wide = [item for item in self._wide.pop(identifier, []) if item[0] is not port]
        if wide:
            self._wide[identifier] = wide
        narrow = [item for item in self._narrow.pop(identifier, []) if item[0] is not port]
        if narrow:
            self._narrow[identifier] = narrow

    @property
    def subscribed(self) -> Iterable[int]:
        """Identifiers that a device listens to."""
        return self._wide

    def subscribers(self, identifier: int) -> int:
        """How many devices listen to an identifier."""
        return len(self._wide.get(identifier, ()))

    def send(self, port: Port, frame: Frame, now_ns: int) -> bool:
        """Queue a frame now; False if the queue is full. The lab has been brought to now."""
        if self._regular:
            if self._puts(port, frame, now_ns):
                return True
            self._leave()
        if self.detour is not None and self.detour(port, frame, now_ns):
            return True
        queue = port.queue
        if len(queue) >= port.depth:
            port.overflows += 1
            return False
        self._line_up(port, frame, now_ns)
        return True

    def _line_up(self, port: Port, frame: Frame, now_ns: int) -> None:
        """Put a frame at the end of its controller's queue."""
        frame.queued_ns = now_ns
        if not port.queue and not port.held:
            heappush(self._heads, (frame.key, port.number, frame, port))
            if now_ns < self._since:
                self._since = now_ns
        port.queue.append(frame)

    def answer(self, port: Port, frame: Frame, now_ns: int) -> None:
        """Queue a device's frame after its response time; a full queue loses and counts it."""
        due_ns = now_ns + self.response_ns
        if self._regular:
            if self._puts(port, frame, due_ns):
                return
            self._leave()
        arrivals = self._arrivals
        if arrivals and arrivals[-1][0] > due_ns:
            self._arrive(due_ns, frame, port)
        else:
            arrivals.append((due_ns, frame, port))

    def _arrive(self, due_ns: int, frame: Frame, port: Port) -> None:
        """Let a frame enter its queue then; of equal times the first come is the first."""
        insort(self._arrivals, (due_ns, frame, port), key=_due)

    def next_ns(self) -> int:
        """The next time at which something happens here on its own, or `NEVER`."""
        if self._regular and self._frame is None:
            return self.wire.next_ns()
        if self._frame is not None:
            return self._end_ns
        return self._start_ns()

    def _start_ns(self) -> int:
        start = self._since
        if self._arrivals and self._arrivals[0][0] < start:
            start = self._arrivals[0][0]
        return start if start > self._free_ns else self._free_ns if start < NEVER else NEVER

    def run(self, to_ns: int) -> None:
        """Let time pass up to ``to_ns``, or to the next frame that concerns others."""
        if self.wide_ns <= to_ns:
            return
        if self._regular:
            if self.wide_ns == NEVER:
                self._run_regularly(to_ns)
            return
        if not self._calm:
            self._run_slowly(to_ns)
            if not self._calm:
                return
        arrivals = self._arrivals
        while True:
            frame = self._frame
            if frame is None:
                start = self._since
                if arrivals and arrivals[0][0] < start:
                    start = arrivals[0][0]
                if start < self._free_ns:
                    start = self._free_ns
                if start >= to_ns:
                    if start == NEVER:
                        self._enter()
                    return
                while arrivals and arrivals[0][0] <= start:
                    due_ns, arrived, port = arrivals.popleft()
                    if not self.send(port, arrived, due_ns) and self._lost(port, start):
                        return
                if not self._heads:
                    continue  # they were all lost at full queues
                frame = self._begin(start)
            end = self._end_ns
            if end > to_ns:
                return
            if not self._finish(frame, end):
                return

    # -- as usual --------------------------------------------------------------------------------

    def _enter(self) -> None:
        """Let the wire have the idle channel, if there is a plan for it."""
        if not self._planned:
            self._planned = True
            usual = self.planner is not None and self.detour is None
            self._plan = self.planner() if self.planner is not None and usual else None
        if self._plan is not None:
            self._regular = True
            self.wire.begin(self._free_ns)
            self._plan.begin(self.wire)

    def _leave(self) -> None:
        """Take the frames back from the wire: something is not as usual."""
        self._planned = False
        if not self._regular:
            return
        self._regular = False
        wire, plan = self.wire, self._plan
        assert plan is not None
        wire.end()
        plan.end(wire)
        self.hand_out()
        state = wire.state
        self._busy_ns += int(state[regular.BUSY])
        self._frames += int(state[regular.FRAMES])
        state[regular.BUSY] = state[regular.FRAMES] = 0
        self._free_ns = int(wire.state[regular.FREE])
        if wire.state[regular.FLYING]:
            self._land()
        ports = {port.number: port for port in self._all_ports}
        for row in range(wire.state[regular.PENDING]):
            frame, number = wire.frame(row)
            port, due_ns = ports[number], frame.queued_ns
            if port.received is None:
                self._arrivals.append((due_ns, frame, port))
            else:
                self._line_up(port, frame, due_ns)

    def _land(self) -> None:
        """Take the frame on the wire as an object."""
        wire = self.wire
        self._frame, number = wire.frame()
        self._frame.sender = next(port for port in self._all_ports if port.number == number)
        self._frame.stamp_ns = self._end_ns = int(wire.state[regular.END])
        wire.state[regular.FLYING] = 0

    def waiting(self, port: Port) -> int:
        """Frames of a controller that the wire has."""
        return self.wire.waiting(port.number) if self._regular else 0

    def disturb(self) -> None:
        """Something happens that is not as usual."""
        self._leave()
        self._calm = False

    def _puts(self, port: Port, frame: Frame, due_ns: int) -> bool:
        if frame.dlc != len(frame.data):
            return False
        return self.wire.put(port.number, frame.key, frame.identifier, frame.data, due_ns)

    def _run_regularly(self, to_ns: int) -> None:
        wire = self.wire
        while self._regular:
            stopped_ns = wire.run(to_ns)
            if stopped_ns == NEVER:
                return
            if not stopped_ns:
                self.hand_out()
                continue
            if self._plan is not None and wire.flying == self._plan.identifier:
                self._leave()  # a SYNC with a counter, which is for each device to heed
                self.run(to_ns)
                return
            self.hand_out()
            self._land()
            assert self._frame is not None
            if not self._finish(self._frame, stopped_ns):
                return

    def hand_out(self) -> None:
        """Let every host have what has ended on the wire."""
        self.wire.hand_out(self._hosts, self._latency)

    def _react(self, now_ns: int) -> bool:
        """A SYNC has ended. False: it has to be delivered to each device."""
        wire, plan = self.wire, self._plan
        assert plan is not None
        if not wire.fits(plan.answers):
            self._leave()
            return False
        self.wide_ns = NEVER
        if wire.delivered_frames >= regular.ROOM:
            self.hand_out()
        plan.react(wire, now_ns)
        return True

    @property
    def ready(self) -> bool:
        """Whether a SYNC waits that compiled code may deliver."""
        return self._regular and self.wire.ready

    def follow(self, left: list[int], now_ns: int) -> None:
        """After a SYNC: have drives apply the set-points that were left to them."""
        assert self._plan is not None
        self._plan.follow(self.wire, left, now_ns)

    # -- otherwise -------------------------------------------------------------------------------

    def _run_slowly(self, to_ns: int) -> None:
        """Let time pass where something is wrong; sets ``_calm`` when nothing is."""
        raise NotImplementedError

    def _lost(self, port: Port, now_ns: int) -> bool:
        """A device's frame met a full queue. True if the lab has to tell the device first."""
        del port, now_ns
        return False

    def _begin(self, start: int) -> Frame:
        """Arbitration: the smallest head wins the bus."""
        _, _, frame, port = heappop(self._heads)
        queue = port.queue
        queue.popleft()
        if queue:
            head = queue[0]
            heappush(self._heads, (head.key, port.number, head, port))
        if not self._heads:
            self._since = NEVER
        self._frame = frame
        frame.sender = port
        data, dlc = frame.data, frame.dlc
        if dlc > _SHORT:
            bits = stuffed_bits(frame.identifier, dlc, _from_bytes(data, "big", signed=True))
            length = self._durations[bits]
        else:
            known = self._short.get((frame.identifier, dlc, data))
            length = self._measured(frame) if known is None else known
        self._end_ns = end = start + length
        self._free_ns = end + self._gap_ns
        self._busy_ns += length + self._gap_ns
        self._frames += 1
        return frame

    def _measured(self, frame: Frame) -> int:
        """A short frame's time, kept for the next of its kind: SYNC, heartbeats, requests."""
        length = self._durations[frame_bits(frame.identifier, frame.dlc, frame.data)]
        if len(self._short) < _KEPT:
            self._short[frame.identifier, frame.dlc, frame.data] = length
        return length

    def _finish(self, frame: Frame, end: int) -> bool:
        """The last bit is over. False if the frame has to wait for the lab."""
        sender = frame.sender
        frame.stamp_ns = end
        if frame.identifier in self._wide:
            narrow = self._narrow.get(frame.identifier)
            handled = 0
            if narrow is not None:
                for port, take in narrow:
                    if port is sender or take(frame):
                        handled += 1
            if handled < len(self._wide[frame.identifier]):
                self.wide_ns = end
                return False
        self._frame = None
        self._hand_out(frame, sender)
        if self._latency is not None:
            self._latency.add(frame.identifier, end - frame.queued_ns)
        return True

    def _hand_out(self, frame: Frame, sender: Port | None) -> None:
        """Let every host have a frame that has ended."""
        row = pack(frame)
        for listener, received in self._hosts:
            if listener is not sender:
                received.append(row)
            elif listener.echo and frame.echoed:
                received.append(pack(frame, own=True))

    def deliver(self) -> None:
        """Deliver the frame, or tell the notices, that waited; the lab stands at their time."""
        frame = self._frame
        now_ns = self.wide_ns
        if self._regular and frame is None:
            if self._react(now_ns):
                return
            frame = self._frame
        self._frame = None
        self.wide_ns = NEVER
        if frame is None or self._notices:
            notices, self._notices = self._notices, []
            for port, notice in notices:
                if port.told is not None:
                    port.told(notice, now_ns)
            if frame is None:
                return
        sender = frame.sender
        self._hand_out(frame, sender)
        if self._latency is not None:
            self._latency.add(frame.identifier, now_ns - frame.queued_ns)
        # Timers may have come first and ended a subscription.
        for port, take in tuple(self._wide.get(frame.identifier, ())):
            if port is not sender:
                take(frame)


def _due(arrival: tuple[int, Frame, Port]) -> int:
    return arrival[0]
