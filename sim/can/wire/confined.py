"""A channel on which frames fail: acknowledge, error frames, confinement, bus-off (ISO 11898-1).

While nothing is wrong (two controllers at least, every counter zero) the channel runs as its base
class does, at its speed.

Readings: an error is seen by everybody at the bit at which it happens; the transmitter flags first,
and the receivers' flags lengthen its by 0 to 6 bits. The queue of a controller in bus-off is kept
and sent after the recovery.
"""

from __future__ import annotations

from dataclasses import dataclass

from tonus.sim.can.wire.channel import NEVER, Channel
from tonus.sim.can.wire.confinement import ErrorState
from tonus.sim.can.wire.error_frames import Violation, report
from tonus.sim.can.wire.frame import Frame
from tonus.sim.can.wire.inbox import pack
from tonus.sim.can.wire.port import Notice, Port
from tonus.sim.can.wire.timing import INTERFRAME_BITS, frame_bits

FLAG_BITS = 6
DELIMITER_BITS = 8
SUSPEND_BITS = 8
RECOVERY_SEQUENCES = 128
SEQUENCE_BITS = 11
AFTER_ACKNOWLEDGE_BITS = 8
"""Acknowledge delimiter and end of frame: the part of a frame that an unacknowledged one lacks."""
_SECOND_NS = 1_000_000_000
_WORSE = {ErrorState.PASSIVE: Notice.PASSIVE, ErrorState.OFF: Notice.BUS_OFF}


@dataclass(frozen=True)
class Failure:
    """Why a frame on the wire fails, after how many of its bits."""

    violation: Violation
    bits: int
    echo_bits: int = 0
    heard: bool = True
    """whether the others see it"""


class ConfinedChannel(Channel):
    """``recovers``: a controller leaves bus-off by itself, after 128 times 11 recessive bits."""

    __slots__ = (
        "_failure",
        "_off",
        "_recovers",
        "_sequence_ns",
        "_suspended",
        "error_frames",
    )

    def __init__(
        self, name: str, bitrate: int, queue_depth: int, response_ns: int, *, recovers: bool = True
    ) -> None:
        super().__init__(name, bitrate, queue_depth, response_ns)
        self.error_frames = 0
        self._recovers = recovers
        self._calm = False
        self._failure: Failure | None = None
        self._off: dict[Port, int] = {}  # sequences of 11 recessive bits seen
        self._suspended: dict[Port, int] = {}  # and until when
        self._sequence_ns = self._bits_ns(SEQUENCE_BITS)

    def _bits_ns(self, bits: int) -> int:
        return -(-bits * _SECOND_NS // self._bitrate)

    def attach(self, *, listens: bool, inbox: int | None = None) -> Port:
        self.disturb()
        return super().attach(listens=listens, inbox=inbox)

    def detach(self, port: Port) -> None:
        self.disturb()
        self._forget(port)
        super().detach(port)

    def restart(self, port: Port) -> None:
        self.disturb()
        super().restart(port)
        if self._failure is not None and self._frame is not None and self._frame.sender is port:
            self._frame = self._failure = None  # it would have been sent again
        self._forget(port)
        port.errors.recover()
        port.held = False

    def _forget(self, port: Port) -> None:
        self._off.pop(port, None)
        self._suspended.pop(port, None)

    # -- time ------------------------------------------------------------------------------------

    def next_ns(self) -> int:
        if self._calm or self._frame is not None:
            return super().next_ns()
        return min(super().next_ns(), self._change_ns())

    def _run_slowly(self, to_ns: int) -> None:
        while self.wide_ns == NEVER:
            frame = self._frame
            if frame is not None:
                if self._end_ns > to_ns:
                    return
                self._end(frame, self._end_ns)
                continue
            if self._settled():
                self._calm = True
                return
            start, change = self._start_ns(), self._change_ns()
            if change <= start and change <= to_ns:
                self._change(change)
            elif start >= to_ns:
                return
            elif self._admit(start) and self._heads:
                self._begin_slowly(start)

    def _settled(self) -> bool:
        ports = self._all_ports
        if len(ports) < 2 or self._suspended:
            return False
        return all(port.errors.clean and not port.overflowing for port in ports)

    def _admit(self, start: int) -> bool:
        """Let frames into their queues. False if the lab has to tell a device first."""
        arrivals = self._arrivals
        while arrivals and arrivals[0][0] <= start:
            due_ns, frame, port = arrivals.popleft()
            if not self.send(port, frame, due_ns) and self._lost(port, start):
                return False
        return True

    def _lost(self, port: Port, now_ns: int) -> bool:
        if port.told is None or port.overflowing:
            return False
        port.overflowing = True
        self.disturb()
        self._tell(port, Notice.OVERFLOW, now_ns)
        return True

    def _change_ns(self) -> int:
        """When the state of a controller changes next without a frame."""
        change = min(self._suspended.values(), default=NEVER)
        if self._recovers and self._off:
            most = min(max(self._off.values()), RECOVERY_SEQUENCES)
            rest_ns = (RECOVERY_SEQUENCES - most) * self._sequence_ns
            change = min(change, self._free_ns + rest_ns)
        return change

    def _change(self, now_ns: int) -> None:
        for port, until_ns in tuple(self._suspended.items()):
            if until_ns <= now_ns:
                del self._suspended[port]
                self._let_go(port, now_ns)
        if self._recovers:
            for port, sequences in tuple(self._off.items()):
                rest_ns = (RECOVERY_SEQUENCES - sequences) * self._sequence_ns
                if self._free_ns + rest_ns <= now_ns:
                    self._recover(port, now_ns)

    def _hold(self, port: Port) -> None:
        """Keep a controller from the arbitration."""
        port.held = True
        self._withdraw(port)

    def _let_go(self, port: Port, now_ns: int) -> None:
        port.held = False
        self._compete(port, now_ns)

    # -- one frame -------------------------------------------------------------------------------

    def _begin_slowly(self, start: int) -> None:
        idle = (start - self._free_ns) // self._sequence_ns
        for port in self._off:
            self._off[port] += idle
        frame = self._begin(start)
        sender = frame.sender
        if sender is not None and not sender.queue:
            sender.overflowing = False
        self._failure = failure = self._fails(frame)
        if failure is not None:
            self._unaccount(start)
            self._end_ns = start + self._bits_ns(failure.bits)
            self._free_ns = self._end_ns + self._tail_ns(failure)
            self._busy_ns += self._free_ns - start

    def _unaccount(self, from_ns: int) -> None:
        """The frame on the wire will not be whole; what was booked for it from then on is not."""
        self._busy_ns -= self._free_ns - from_ns
        self._frames -= 1

    def _tail_ns(self, failure: Failure) -> int:
        """From an error to the end of the space behind its error frame."""
        return self._bits_ns(FLAG_BITS + failure.echo_bits + DELIMITER_BITS + INTERFRAME_BITS)

    def _fails(self, frame: Frame) -> Failure | None:
        """What becomes of a frame that begins now; None if it is sound."""
        sender = frame.sender
        if all(port is sender or port.errors.off for port in self._all_ports):
            bits = frame_bits(frame.identifier, frame.dlc, frame.data)
            return Failure(Violation.UNACKNOWLEDGED, bits - AFTER_ACKNOWLEDGE_BITS)
        return None

    def _end(self, frame: Frame, end: int) -> None:
        """A frame's last bit, or its error."""
        for port in self._off:
            self._off[port] += 1
        sender = frame.sender
        assert sender is not None
        failure, self._failure = self._failure, None
        if failure is not None:
            self._frame = None
            self._fail(frame, sender, failure, end)
        else:
            self._credit(sender, end)
            self._arrived(frame, sender, end)
        if sender in self._all_ports and sender.errors.passive and not sender.held:
            self._hold(sender)
            self._suspended[sender] = self._free_ns + self._bits_ns(SUSPEND_BITS)

    def _arrived(self, frame: Frame, sender: Port, end: int) -> None:
        del sender
        self._finish(frame, end)

    def _fail(self, frame: Frame, sender: Port, failure: Failure, end: int) -> None:
        self.error_frames += 1
        sender.retransmissions += 1
        self._return(sender, frame, end)
        for port in tuple(self._all_ports):
            before = port.errors.state
            if before is ErrorState.OFF or not (failure.heard or port is sender):
                continue
            if port is not sender:
                port.errors.receive_failed()
            elif failure.violation is Violation.UNACKNOWLEDGED:
                port.errors.not_acknowledged()
            else:
                port.errors.transmit_failed()
            violation = failure.violation if port is sender else Violation.STUFF
            self._note(port, before, end, violation, transmitting=port is sender)

    def _return(self, port: Port, frame: Frame, now_ns: int) -> None:
        """Put a frame back at the head of its sender's queue, wherever the sender is by now."""
        wire = port.channel
        if port in wire.ports:
            wire._withdraw(port)
            port.queue.appendleft(frame)
            if not port.held:
                wire._compete(port, now_ns)

    def _credit(self, sender: Port, end: int) -> None:
        """Everybody has seen a sound frame."""
        for port in self._all_ports:
            errors = port.errors
            if errors.off or errors.clean:
                continue
            before = errors.state
            if port is sender:
                errors.sent()
            else:
                errors.received()
            self._note(port, before, end)

    # -- one controller --------------------------------------------------------------------------

    def _note(
        self,
        port: Port,
        before: ErrorState,
        now_ns: int,
        violation: Violation | None = None,
        *,
        transmitting: bool = False,
    ) -> None:
        """Tell a host of an error or a new state, and a device of a worse one."""
        state = port.errors.state
        if port.reports and (violation is not None or state is not before):
            assert port.received is not None
            frame = report(port.errors, now_ns, before, violation, transmitting=transmitting)
            port.received.append(pack(frame))
        if state is before or before is ErrorState.OFF:
            return
        if state is ErrorState.OFF:
            self._off[port] = 0
            self._suspended.pop(port, None)
            self._hold(port)
            self._deafen(port)
        if state in _WORSE:
            self._tell(port, _WORSE[state], now_ns)

    def _tell(self, port: Port, notice: Notice, now_ns: int) -> None:
        if port.told is not None:
            self._notices.append((port, notice))
            self.wide_ns = now_ns

    def _recover(self, port: Port, now_ns: int) -> None:
        port.errors.recover()
        del self._off[port]
        self._hear(port)
        self._let_go(port, now_ns)
        self._note(port, ErrorState.OFF, now_ns)
        self._tell(port, Notice.RECOVERED, now_ns)

    def _hear(self, port: Port) -> None:
        if port.received is not None:
            self._hosts.append((port, port.received))
            self._hosts.sort(key=lambda host: host[0].number)
