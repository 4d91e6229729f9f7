"""What the tests of a supervisor share that judges records alone: records in order, the bus of the
relay, and a supervisor that is given them."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Any

import can
import numpy as np

from tonus.config import Config
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.signals import cycle_dtype
from tonus.runtime.states import Operator, State
from tonus.runtime.supervisor.record import New
from tonus.runtime.supervisor.supervisor import Supervisor

MS = 1_000_000
ENABLED, AT_A_LIMIT, DISABLED, QUICK_STOP = 0x0237, 0x0A37, 0x0240, 0x0217
NODE = 120
BEAT = (0x77E, b"\5")
HELD, RELEASED = (0x200 + NODE, b"\1"), (0x200 + NODE, b"\0")
ROBOT: dict[str, Any] = {
    "supervisor.policy": "use",
    "supervisor.period_ms": 2,
    "supervisor.timeout_ms": 22,
    "supervisor.patience_ms": 5,
    "sto_relay.timeout_ms": 7,
}
Change = Callable[[Any], None]


class FakeBus:
    """Of the relay's channel."""

    def __init__(self) -> None:
        self.waiting: list[can.Message] = []
        self.sent: list[tuple[int, bytes]] = []
        self.broken = self.echoes = False

    def recv(self, timeout: float | None = None) -> can.Message | None:
        assert timeout == 0
        return self.waiting.pop(0) if self.waiting else None

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        del timeout
        if self.broken:
            raise can.CanError("gone")
        assert not message.is_extended_id
        self.sent.append((message.arbitration_id, bytes(message.data)))
        if self.echoes:
            self.waiting.append(message)

    def shutdown(self) -> None:
        """Nothing is held."""


def record_of(cables: int, now_ms: int) -> Any:
    """A robot that is held still, in order."""
    record = np.zeros(1, cycle_dtype(cables))[0]
    record["timing"]["tick"] = now_ms
    record["state"]["state"] = State.HOLD
    record["stiffness"]["k_eq"] = 3000.0
    drives, cells = record["drives"], record["force_cells"]
    drives["statusword"] = ENABLED
    cells["raw"][:-1] = record["tension"]["measured"] = record["tension"]["reference"] = 50.0
    # So that its torques are not equal to the last bit.
    drives["torque_command"] = drives["torque"] = 1.0 + 0.01 * (now_ms % 5)
    return record


class Held:
    """A supervisor, its relay's bus, and what a daemon records each ms; ``change`` is applied."""

    def __init__(self, config: Config) -> None:
        self.spent_ns = 0
        """of the processor's time since a look began, when it sends"""
        self.bus, self.config = FakeBus(), config
        self.answers = True
        self.recorded = True
        self.later_ns = 0
        """of a look than the newest record"""
        self.waiting: list[tuple[int, Any]] = []
        self._now = 0
        self.supervisor = Supervisor(
            config,
            self._new,
            lambda _, name, __: self.opened(name),  # type: ignore[arg-type, return-value]
            lambda: self._now * MS + self.spent_ns,
        )

    def opened(self, channel: str) -> FakeBus:
        """The bus of a channel; there is that of the relay alone."""
        del channel
        return self.bus

    def _new(self) -> New:
        new, self.waiting = self.waiting, []
        records = np.array([record for _, record in new], cycle_dtype(self.config.robot.cables))
        return [stamp for stamp, _ in new], records

    def step(self, change: Change = lambda _: None) -> list[tuple[int, bytes]]:
        """Two ms later: what it sends."""
        for _ in range(2):
            self._now += 1
            record = record_of(self.config.robot.cables, self._now)
            change(record)
            if self.recorded:
                self.waiting.append((self._now * MS, record))
        if self.answers:
            beat = can.Message(arbitration_id=0x700 + NODE, is_extended_id=False, data=b"\5")
            self.bus.waiting.append(beat)
        return self.look(self.later_ns)

    def look(self, later_ns: int = 0) -> list[tuple[int, bytes]]:
        """So long after the newest record: what it sends."""
        self.bus.sent = []
        self.supervisor.step(self._now * MS + later_ns)
        return self.bus.sent

    def steps(self, count: int, change: Change = lambda _: None) -> Iterator[list[Any]]:
        for _ in range(count):
            yield self.step(change)

    def armed(self) -> Held:
        """It holds the relay, and the robot is controlled."""
        list(self.steps(160, disarmed))
        assert self.step() == [BEAT, HELD]
        assert all(sent == [BEAT, HELD] for sent in self.steps(20))
        return self

    def stopped_for(self, change: Change, within: int = 10) -> Requirement:
        """What a change makes of it: an emergency, and the output off in the same look."""
        for sent in self.steps(within, change):
            if sent != [BEAT, HELD]:
                break
        identifier, data = sent[0]
        code, register, _, _ = struct.unpack("<HBBf", data)
        assert (identifier, register) == (0x0FE, 0x81)
        assert sent[1:] == [RELEASED]
        assert not self.supervisor.beating
        assert all(sent == [] for sent in self.steps(5, change))
        return Requirement(code - 0xFF00)


def failed(record: Any) -> None:
    disarmed(record)
    record["state"]["state"], record["state"]["operator"] = State.FAULT, Operator.NONE


def disarmed(record: Any) -> None:
    record["state"]["state"] = State.STANDBY
    record["state"]["operator"] = Operator.RESET
    record["drives"]["statusword"] = DISABLED
    record["drives"]["torque_command"] = record["drives"]["torque"] = 0.0


def out_of_bounds(record: Any) -> None:
    record["stiffness"]["k_eq"] = 1e5
