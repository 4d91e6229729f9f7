"""A channel that can be disturbed: frames lost, flipped, late or doubled; a controller that sends
without pause; a bus stuck at a level; controllers cut off, each on a wire of its own.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from tonus.config.schema.faults import Babble, Corruption, Delay, Duplicate, Level, Loss
from tonus.sim.can.wire.channel import NEVER
from tonus.sim.can.wire.confined import FLAG_BITS, ConfinedChannel, Failure
from tonus.sim.can.wire.error_frames import Violation
from tonus.sim.can.wire.frame import Frame
from tonus.sim.can.wire.frame_faults import Babbler, Copy, FrameFault
from tonus.sim.can.wire.port import Port
from tonus.sim.can.wire.timing import frame_bits

_FIRST_DOMINANT_BITS = 14
_DOMINANT_BITS = 8
"""Dominant bits behind an error flag after which, and after each of which, everybody counts by 8
(ISO 11898-1, fault confinement rule f)."""
_DOMINANT_STEP = 8


def _nobody() -> None:
    """Nobody cares about severed wires."""


class FaultyChannel(ConfinedChannel):
    """``rewired`` is called when a wire comes to ``severed`` or goes."""

    __slots__ = (
        "_babblers",
        "_cut",
        "_delays",
        "_dominant_ns",
        "_faults",
        "_lost_frame",
        "_rewired",
        "_struck",
        "_stuck",
        "_twice",
        "_underway",
        "severed",
    )

    def __init__(
        self,
        name: str,
        bitrate: int,
        queue_depth: int,
        response_ns: int,
        *,
        recovers: bool = True,
        rewired: Callable[[], None] = _nobody,
    ) -> None:
        super().__init__(name, bitrate, queue_depth, response_ns, recovers=recovers)
        self.severed: list[FaultyChannel] = []
        self._rewired = rewired
        self._cut = False
        self._stuck: Level | None = None
        self._dominant_ns = NEVER  # the next count of a bus held dominant
        self._struck: Port | None = None  # who was sending when it stuck
        self._faults: list[FrameFault] = []
        self._delays: list[FrameFault] = []
        self._underway: set[Frame] = set()  # they have been delayed
        self._babblers: list[Babbler] = []
        self._lost_frame = False
        self._twice = False

    # -- who is on the wire ----------------------------------------------------------------------

    def attach(self, *, listens: bool, inbox: int | None = None) -> Port:
        """A new controller; while the hosts are cut off, a new one is as well."""
        port = super().attach(listens=listens, inbox=inbox)
        port.held = self._stuck == "dominant"
        if listens and self._cut:
            self.sever(port, 0)
        return port

    def sever(self, port: Port, now_ns: int) -> None:
        """Cut a controller off, with what it has queued: it goes on alone."""
        wire = FaultyChannel(
            self.name, self._bitrate, self._depth, self.response_ns, recovers=self._recovers
        )
        self.severed.append(wire)
        self._hand_over(port, wire, now_ns)
        self._rewired()

    def rejoin(self, port: Port, now_ns: int) -> None:
        """Undo `sever`; without effect on a controller that is not cut off."""
        for wire in self.severed:
            if port.channel is wire:
                wire._abort(port)
                wire._hand_over(port, self, now_ns)
                self.severed.remove(wire)
                self._rewired()
                return

    def _abort(self, port: Port) -> None:
        """Take back the frame that a lone controller is sending in vain."""
        frame = self._frame
        if frame is not None:
            self._frame = self._failure = None
            port.queue.appendleft(frame)

    def _hand_over(self, port: Port, wire: FaultyChannel, now_ns: int) -> None:
        self.disturb()
        wire.disturb()
        self._withdraw(port)
        self._forget(port)
        self._deafen(port)
        self._all_ports.remove(port)
        pending = self._arrivals
        self._arrivals = deque(item for item in pending if item[2] is not port)
        port.channel = wire
        wire._all_ports.append(port)
        for due_ns, frame, sender in pending:
            if sender is port:
                wire._arrive(due_ns, frame, port)
        port.held = port.errors.off or wire._stuck == "dominant"
        if port.errors.off:
            wire._off[port] = 0
            wire._free_ns = max(wire._free_ns, now_ns)
        else:
            wire._hear(port)
        if not port.held:
            wire._compete(port, now_ns)

    def cut(self, now_ns: int) -> None:
        """Separate every host from the devices, and from each other; `mend` ends it."""
        self._cut = True
        for port, _ in tuple(self._hosts):
            self.sever(port, now_ns)

    def mend(self, now_ns: int) -> None:
        self._cut = False
        for wire in tuple(self.severed):
            for port in wire.ports:
                if port.received is not None:
                    self.rejoin(port, now_ns)
            if wire in self.severed and not wire.ports:
                self.severed.remove(wire)

    def restart(self, port: Port) -> None:
        super().restart(port)
        port.held = self._stuck == "dominant"

    # -- faults ----------------------------------------------------------------------------------

    def add(self, fault: FrameFault) -> None:
        self.disturb()
        if isinstance(fault.fault, Delay):
            self._delays.append(fault)
            self.detour = self._delay
        else:
            self._faults.append(fault)

    def remove(self, fault: FrameFault) -> None:
        self._faults = [other for other in self._faults if other is not fault]
        self._delays = [other for other in self._delays if other is not fault]
        if not self._delays:
            self.detour = None
            self._underway.clear()

    def babble(self, fault: Babble, now_ns: int) -> Port:
        """Start a babbling controller; `hush` ends it."""
        port = self.attach(listens=False)
        port.name = "babbler"
        babbler = Babbler(port, fault.identifier, fault.period_us * 1000, now_ns)
        self._babblers.append(babbler)
        self._refill(babbler, now_ns)
        return port

    def hush(self, port: Port) -> None:
        self._babblers = [babbler for babbler in self._babblers if babbler.port is not port]
        self.detach(port)

    def _refill(self, babbler: Babbler, now_ns: int) -> None:
        due_ns, frame = babbler.next(now_ns)
        self._arrive(due_ns, frame, babbler.port)

    def jam(self, level: Level, now_ns: int) -> None:
        """Hold the bus at a level; `release` ends it. A frame on the wire is destroyed."""
        self.disturb()
        self._stuck = level
        self._struck = None
        if self._frame is not None:
            self._struck = self._frame.sender
            if self._failure is None:
                self._unaccount(now_ns)
            self._failure = failure = Failure(Violation.BIT, 0, heard=level == "dominant")
            self._end_ns = now_ns
            self._free_ns = now_ns + self._tail_ns(failure)
        if level == "dominant":
            bits = 2 * FLAG_BITS + _FIRST_DOMINANT_BITS
            self._dominant_ns = now_ns + self._bits_ns(bits)
            for port in self._all_ports:
                self._hold(port)

    def release(self, now_ns: int) -> None:
        """Let the bus go: it is idle after eleven recessive bits."""
        self._stuck = None
        self._dominant_ns = NEVER
        self._free_ns = max(self._free_ns, now_ns + self._sequence_ns)
        self._suspended.clear()
        for port in self._all_ports:
            if port.held and port not in self._off:
                self._let_go(port, now_ns)

    # -- what they do ----------------------------------------------------------------------------

    def _settled(self) -> bool:
        if self._stuck or self._faults or self._delays or self._babblers:
            return False
        return super()._settled()

    def _change_ns(self) -> int:
        return super()._change_ns() if self._stuck != "dominant" else self._dominant_ns

    def _change(self, now_ns: int) -> None:
        if self._stuck != "dominant":
            super()._change(now_ns)
            return
        again = False
        for port in tuple(self._all_ports):
            errors = port.errors
            before = errors.state
            if errors.off:
                continue
            if port is self._struck:
                errors.transmit_failed()
            else:
                errors.receive_failed(_DOMINANT_STEP)
            self._note(port, before, now_ns, Violation.STUFF)
            again = again or not (errors.off if port is self._struck else errors.passive)
        self._dominant_ns = now_ns + self._bits_ns(_DOMINANT_BITS) if again else NEVER

    def _fails(self, frame: Frame) -> Failure | None:
        if self._stuck is not None:
            # Its first bit is dominant and reads back recessive; nobody else sees a thing.
            return Failure(Violation.BIT, 1, heard=False)
        failure = super()._fails(frame)
        if failure is not None:
            return failure
        for fault in self._faults:
            if isinstance(fault.fault, Duplicate) and isinstance(frame, Copy):
                continue
            if not fault.strikes(frame):
                continue
            if isinstance(fault.fault, Corruption):
                bits = frame_bits(frame.identifier, frame.dlc, frame.data)
                place = 1 + int(fault.fraction() * bits)
                echo = int(fault.fraction() * (FLAG_BITS + 1))
                return Failure(Violation.BIT, place, echo)
            self._twice |= isinstance(fault.fault, Duplicate)
            self._lost_frame |= isinstance(fault.fault, Loss)
        return None

    def _arrived(self, frame: Frame, sender: Port, end: int) -> None:
        if self._twice:
            self._return(sender, Copy(frame), end)
        if self._lost_frame:
            self._frame = None
        else:
            super()._arrived(frame, sender, end)

    def _end(self, frame: Frame, end: int) -> None:
        super()._end(frame, end)
        self._twice = self._lost_frame = False
        for babbler in self._babblers:
            if babbler.port is frame.sender and not babbler.port.queue:
                self._refill(babbler, end)

    def _delay(self, port: Port, frame: Frame, now_ns: int) -> bool:
        if frame in self._underway:
            self._underway.remove(frame)
            return False
        wait_ns = 0
        for fault in self._delays:
            if isinstance(fault.fault, Delay) and fault.strikes(frame):
                wait_ns += fault.fault.delay_us * 1000
        if wait_ns:
            self._underway.add(frame)
            self._arrive(now_ns + wait_ns, frame, port)
        return wait_ns > 0
