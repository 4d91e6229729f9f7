"""What the supervisor sends: heartbeats, emergency frames, and a relay's output."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence

import can
import numpy as np

from tonus.config.schema.sto_relay import StoRelay
from tonus.config.schema.supervisor import Supervisor as Settings
from tonus.runtime.supervisor.commands import Own
from tonus.runtime.supervisor.heartbeat import Beats
from tonus.runtime.supervisor.judge import NOWHERE, Violation
from tonus.runtime.supervisor.observation import Listened
from tonus.runtime.supervisor.watched import HEARTBEAT, OUTPUT

_EMERGENCY = 0x080
_HELD, _RELEASED = b"\1", b"\0"
"""digital outputs of the relay's node: bit 0 is the coil"""
_OPERATIONAL = b"\5"
_ERROR = struct.Struct("<HBBf")
"""Error code, error register, axis or 0xFF, value; CiA 301 leaves the last five to the device."""
_ERROR_CODE, _REGISTER, _NO_AXIS = 0xFF00, 0x81, 0xFF
_LARGEST = 3.4e38
"""below the largest float of 32 bits"""


class Voice:
    """What cannot be sent is missed: it never raises for a bus."""

    def __init__(
        self,
        settings: Settings,
        relay: StoRelay | None,
        buses: Sequence[tuple[str, can.BusABC]],
        heard: Listened,
        clock: Callable[[], int] | None,
    ) -> None:
        """``buses`` by their channels' names; ``clock`` as of `Supervisor`."""
        self._settings, self._clock = settings, clock
        self._buses = [bus for _, bus in buses]
        self.beating = [False] * len(buses)
        """on each channel"""
        timeout_ms = settings.timeout_ms if relay is None else relay.timeout_ms
        self.timeout_ns = timeout_ms * 1_000_000
        """how long drives, or the relay's node, wait for its heartbeat"""
        own = HEARTBEAT + settings.node_id
        self._beats = [
            Beats(own, heard[name, own], settings.period_ms, timeout_ms) for name, _ in buses
        ]
        self._beat_ns = [0] * len(buses)
        """when each was sent a heartbeat last"""
        self._unwatched_ns: list[int | None] = [None] * len(buses)
        """since when drives of each have power without a heartbeat, or since the last single one"""
        self._output: Own | None = None
        """what the relay's node is told"""
        self._begun = False
        """a heartbeat was sent since it began"""
        self._holds = False
        """whether it has set the relay's output"""
        self.own: list[Own] = [*self._beats]
        """what only the supervisor sends"""
        if relay is not None:
            output = OUTPUT + relay.node_id
            self._output = Own(output, heard[relay.channel, output])
            self.own.append(self._output)

    def begin(self, now_ns: int) -> None:
        """On every channel."""
        self.beating = [True] * len(self._buses)
        self._beat_ns = [now_ns] * len(self._buses)
        self._begun = False
        for own in self.own:
            own.begin()

    def end(self) -> None:
        """On every channel, and nothing is told."""
        self.beating = [False] * len(self._buses)

    def fall_silent(self, found: Violation, *, everywhere: bool) -> None:
        """On every channel. ``everywhere``: it is told where no heartbeat goes too."""
        self.tell(found, [beating or everywhere for beating in self.beating])
        self.end()

    def tell(self, found: Violation, where: Sequence[bool] | None = None) -> None:
        """On every channel, or on those of ``where``."""
        for place in np.flatnonzero([True] * len(self._buses) if where is None else where).tolist():
            self._send(place, _EMERGENCY + self._settings.node_id, emergency(found))

    def begin_watches(self, now_ns: int, powered: Sequence[bool], *, quiet: bool) -> None:
        """Drives that keep power although they get no heartbeat, or were told to beside their
        process data (``powered``, by channel), have heard none since they were started, or reset: a
        single one begins their watch (CiA 301). The next one comes when that is over, so that no
        drive is held, and later where the last one waits still, or was lost. Pauses of the power
        count with it, until no drive has been enabled for ``quiet_s``."""
        for place, beating in enumerate(self.beating):
            since_ns = self._unwatched_ns[place]
            if beating or (quiet and not powered[place]):
                self._unwatched_ns[place] = None
            elif not powered[place]:
                continue
            elif since_ns is None or self._beats[place].heard.at_ns > since_ns:
                self._unwatched_ns[place] = now_ns
            else:
                beats = self._beats[place]
                # Farther apart than drives or a relay need: closer ones would be what holds them.
                longest_ns = max(self.timeout_ns, self._settings.timeout_ms * 1e6)
                due_ns = (8.0 if beats.waits else 2.0) * longest_ns
                if now_ns - since_ns < due_ns:
                    continue
                beats.give_up()
                if self._tell(place, beats, _OPERATIONAL):
                    self._unwatched_ns[place] = now_ns

    def beat(self, now_ns: int) -> bool:
        """Whether none went out on a channel for so long that drives have lost it: none follows
        there. Once a look has lost its processor none is sent: what it saw is too old."""
        lost = False
        for place in np.flatnonzero(self.beating).tolist():
            beats = self._beats[place]
            if (
                self._is_in_time(now_ns)
                and beats.follows()
                and self._tell(place, beats, _OPERATIONAL)
            ):
                self._beat_ns[place] = now_ns
                self._begun = True
            if now_ns - self._beat_ns[place] > self.timeout_ns:
                self.beating[place], lost = False, True
        return lost

    def hold_relay(self, now_ns: int) -> None:
        """Its output is on as long as the heartbeat goes, and is off at once with its end. It is
        not switched on before the node was sent one, nor, like a heartbeat, by what was seen too
        long ago: the node, just started, would wait for none."""
        beating = any(self.beating)
        if self._output is None or not (beating or self._holds):
            return
        if beating and not (self._begun and self._is_in_time(now_ns)):
            return
        told = self._tell(0, self._output, _HELD if beating else _RELEASED)
        self._holds = beating or not told

    def _is_in_time(self, now_ns: int) -> bool:
        """Whether the look that began then has kept its processor."""
        spent_ns = 0 if self._clock is None else self._clock() - now_ns
        return spent_ns <= self._settings.period_ms * 1e6

    def _tell(self, place: int, own: Own, data: bytes) -> bool:
        """Send what only the supervisor sends."""
        taken = self._send(place, own.identifier, data)
        if taken:
            own.send()
        return taken

    def _send(self, place: int, identifier: int, data: bytes) -> bool:
        """Whether the interface of that channel has taken it."""
        message = can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
        try:
            self._buses[place].send(message)
        except (can.CanError, OSError):
            return False
        return True


def emergency(violation: Violation) -> bytes:
    """The data of its emergency frame (CiA 301)."""
    place = _NO_AXIS if violation.where == NOWHERE else violation.where
    value = violation.value
    if not abs(value) < _LARGEST:
        value = math.copysign(math.inf, value)
    return _ERROR.pack(_ERROR_CODE + violation.requirement, _REGISTER, place, value)
