"""Who is in OP and who is not: the states of all slaves, and the way back into it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from tonus.config.schema.bus import EthercatBus
from tonus.drivers.ethercat.al import ERROR, AlState
from tonus.drivers.ethercat.slave import Slave
from tonus.drivers.ethercat.status import SlaveStatus
from tonus.drivers.ethercat.wire import Wire
from tonus.drivers.events import EventLog
from tonus.drivers.exchange import Exchange

_NEXT = {AlState.PREOP: AlState.SAFEOP, AlState.SAFEOP: AlState.OP}


@dataclass
class Watched:
    """A slave and what was seen of it."""

    slave: Slave
    left: str = ""
    """why it takes no part; "" while it is in OP"""
    busy: bool = False
    """it is being configured anew: nobody else is to move it"""
    attempts: int = 0
    """times it was brought back since the last reset"""
    status: SlaveStatus | None = None

    @property
    def lost_everything(self) -> bool:
        """Silent, or restarted: it knows neither its address nor its process data."""
        return self.status is None or self.status.state in (AlState.INIT, AlState.BOOT)


class Present(NamedTuple):
    """Who takes part in an exchange."""

    delivers: list[bool]
    """of each slave: its inputs are its own"""
    counter: int
    """the working counter that comes of it"""


class Watch:
    """Tells of every slave that left OP, keeps control from believing it, and brings it back."""

    def __init__(self, bus: EthercatBus, exchange: Exchange, events: EventLog) -> None:
        self.watched: list[Watched] = []
        self._recovers = bus.master.state_policy == "recover"
        self._attempts = bus.master.attempts
        self._limit_ns = bus.clocks.limit_ns
        self._ends = bus.interfaces
        self._exchange = exchange
        self._events = events
        self._open_after: int | None = None
        self.present: Present | None = None
        """who was there when all were looked at last; None: nobody has looked"""

    def begin(self, slaves: list[Slave]) -> None:
        self.watched = [Watched(slave) for slave in slaves]
        self._open_after = None
        self.present = None

    @property
    def complete(self) -> bool:
        """Every slave is in OP."""
        return not any(each.left for each in self.watched)

    def see(self, found: list[SlaveStatus | None], wire: Wire) -> None:
        """The answer to a look at all slaves."""
        if wire.open_after != self._open_after:
            self._open_after = wire.open_after
            self._tell_of_the_ring(wire.open_after)
        counts = [
            0 if status is None else watched.slave.counts(status.state)
            for watched, status in zip(self.watched, found, strict=True)
        ]
        self.present = Present([count > 0 for count in counts], sum(counts))
        for watched, status in zip(self.watched, found, strict=True):
            if status != watched.status or watched.left:
                self._judge(watched, status, wire)

    def forgive(self, watched: Watched) -> None:
        """An operator's reset: as many attempts as at the start."""
        watched.attempts = 0
        self._events.end("slave_given_up", watched.slave.where)

    def _judge(self, watched: Watched, status: SlaveStatus | None, wire: Wire) -> None:
        watched.status = status
        slave = watched.slave
        if status is None:
            text = f"{slave.title} takes no part in any exchange"
            watched.left = "it is silent"
            self._events.begin("slave_silent", slave.where, text)
            return
        self._events.end("slave_silent", slave.where)
        self._look_at_the_clock(slave, status)
        self._trust(watched, good=status.operational)
        if status.operational:
            if watched.left:
                watched.left = ""
                self._events.end("slave_left_op", slave.where)
                self._events.counted("slave_recovered", slave.where, f"{slave.title} is in OP")
            return
        if status.error or not watched.left:
            watched.left = str(status)
            text = f"{slave.title} is in {status}"
            self._events.begin("slave_left_op", slave.where, text)
        if self._recovers and not watched.busy:
            self.bring_back(watched, wire)

    def bring_back(self, watched: Watched, wire: Wire) -> None:
        """One step towards OP. A slave in INIT has lost what it was told: it needs more."""
        status, slave = watched.status, watched.slave
        if status is None or status.state not in (*_NEXT, AlState.OP):
            return
        if status.error:
            if watched.attempts >= self._attempts:
                text = f"{slave.title} left OP {watched.attempts + 1} times"
                self._events.begin("slave_given_up", slave.where, text)
                return
            watched.attempts += 1
            wire.control({slave.number: status.state | ERROR})
        elif status.state in _NEXT:
            wire.control({slave.number: _NEXT[AlState(status.state)]})

    def _trust(self, watched: Watched, *, good: bool) -> None:
        """Only of an axis that answers: silence ages it. Cells need no mark: in SAFEOP they are
        still measured, below it they age."""
        if watched.slave.axis is not None:
            self._exchange.untrusted[watched.slave.axis] = not good

    def _tell_of_the_ring(self, after: int | None) -> None:
        events, here = self._events, self._ends[0]
        events.end("ring_open", here)
        if after is None:
            events.add("ring_closed", here, "all cables are connected again")
            return
        places = [here, *(each.slave.where for each in self.watched), *self._ends[1:]]
        text = f"no cable between {places[after]} and {places[after + 1]}"
        events.begin("ring_open", here, text)

    def _look_at_the_clock(self, slave: Slave, status: SlaveStatus) -> None:
        if abs(status.difference_ns) <= self._limit_ns:
            self._events.end("clock_astray", slave.where)
        else:
            text = f"{slave.title}: {status.difference_ns} ns from the reference clock"
            self._events.begin("clock_astray", slave.where, text)
