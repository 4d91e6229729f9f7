"""Look, judge, and send the heartbeat or be silent."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable

import can

from tonus.config.schema.root import Config
from tonus.config.schema.supervisor import REQUIREMENT_TEXTS
from tonus.runtime.supervisor.judge import NOWHERE, Judge, Violation
from tonus.runtime.supervisor.listener import Listener, Watched
from tonus.runtime.supervisor.observation import Listened, Observation, Observer
from tonus.runtime.supervisor.record import Records, claims
from tonus.runtime.supervisor.wiring import Value, Wiring

OpenBus = Callable[[str, str, int], can.BusABC]
"""From interface, channel and bit rate."""
_EMERGENCY, _HEARTBEAT = 0x080, 0x700
_OPERATIONAL = b"\5"
_ERROR = struct.Struct("<HBBf")
"""Error code, error register, axis or 0xFF, value; CiA 301 leaves the last five to the device."""
_ERROR_CODE, _REGISTER, _NO_AXIS = 0xFF00, 0x81, 0xFF


class Supervisor:
    """Call `step` every ``supervisor.period_ms``.

    It is silent at first, and after a violation; the heartbeat begins when no drive has been
    enabled for ``quiet_s`` and everything arrives that it judges by. So its restart, or a mistake
    of its own that has passed, gives an armed robot nothing back, and a drive that it stopped needs
    the operator's reset.
    """

    def __init__(self, config: Config, records: Records, open_bus: OpenBus) -> None:
        """Raises `can.CanError` and OSError when a channel cannot be opened, and ValueError for a
        configuration without a supervisor."""
        settings = config.supervisor
        if settings is None or settings.policy == "off":
            raise ValueError("the configuration has no supervisor")
        self.settings = settings
        self.violation: Violation | None = None
        """what it stopped the robot for; None while it sends its heartbeat"""
        self.beating = False
        wiring = Wiring(config)
        self._records = records
        self._observe = Observer(wiring, settings, config.robot.contact_cell)
        self._judge = Judge(config, settings)
        self._quiet_ns: int | None = None
        self._listeners: list[Listener] = []
        for interface, channel, bitrate in wiring.channels:
            bus = open_bus(interface, channel, bitrate)
            self._listeners.append(Listener(bus, _watched(wiring, channel)))
        self._heard: Listened = {
            (channel, identifier): heard
            for (_, channel, _), listener in zip(wiring.channels, self._listeners, strict=True)
            for identifier, heard in listener.heard.items()
        }

    def step(self, now_ns: int) -> None:
        """Never raises for a bus: what cannot be received ages, what cannot be sent is missed."""
        for listener in self._listeners:
            with contextlib.suppress(can.CanError, OSError):
                listener.read(now_ns)
        seen = self._observe(now_ns, self._heard, claims(self._records()))
        present = seen.measured_age < self.settings.stale_ms
        # Where nothing is heard of any drive, what was enabled still is: a supervisor that has
        # gone deaf must not take that for a robot at rest.
        armed = bool((seen.enabled & (present | ~present.any())).any())
        if armed:
            self._quiet_ns = None
        elif self._quiet_ns is None:
            self._quiet_ns = now_ns
        if not self.beating:
            quiet = self._quiet_ns is not None and (
                now_ns - self._quiet_ns >= self.settings.quiet_s * 1e9
            )
            if not (quiet and self._hears(seen)):
                return
            self.beating, self.violation = True, None
        if armed:
            self.violation = self._judge(seen)
            if self.violation is not None:
                self.beating = False
                self._send(_EMERGENCY, _error(self.violation))
                return
        self._send(_HEARTBEAT, _OPERATIONAL)

    def _hears(self, seen: Observation) -> bool:
        """Whether everything arrives that it judges by: it does not begin deaf."""
        ages = [*seen.measured_age, *seen.torque_age, *seen.cell_age, seen.contact_age]
        return bool(max(ages) < self.settings.stale_ms)

    def close(self) -> None:
        """Its heartbeat ends with it."""
        for listener in self._listeners:
            listener.bus.shutdown()

    def _send(self, function: int, data: bytes) -> None:
        identifier = function + self.settings.node_id
        message = can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
        for listener in self._listeners:
            with contextlib.suppress(can.CanError, OSError):
                listener.bus.send(message)


def told(violation: Violation) -> str:
    """In one line."""
    where = "" if violation.where == NOWHERE else f" at axis {violation.where}"
    number = violation.requirement
    return f"SUP-{number:d}{where}, {violation.value:.4g}: broken is: {REQUIREMENT_TEXTS[number]}"


def _error(violation: Violation) -> bytes:
    place = _NO_AXIS if violation.where == NOWHERE else violation.where
    return _ERROR.pack(_ERROR_CODE + violation.requirement, _REGISTER, place, violation.value)


def _watched(wiring: Wiring, channel: str) -> list[Watched]:
    """Every identifier of a channel that tells of an axis or a cell."""
    found: dict[int, tuple[int, list[Value]]] = {}
    for axis in wiring.axes:
        if axis.channel == channel:
            found[axis.sent] = axis.sent_bytes, [axis.torque]
            found[axis.received] = axis.received_bytes, [axis.position]
    for cell in wiring.cells:
        if cell.channel == channel:
            found.setdefault(cell.received, (cell.received_bytes, []))[1].append(cell.force)
    return [Watched(number, size, tuple(values)) for number, (size, values) in found.items()]
