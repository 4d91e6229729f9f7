"""What the tests of the supervisor share: records and observations that are in order, buses, the
frames of every axis and cell."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import can
import numpy as np

from tonus.config import Config
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.signals import cycle_dtype
from tonus.runtime.states import ARMED, Operator, State
from tonus.runtime.supervisor.judge import Judge, Violation
from tonus.runtime.supervisor.listener import Errors, Heard
from tonus.runtime.supervisor.observation import Observation, Observer
from tonus.runtime.supervisor.record import Claim, New
from tonus.runtime.supervisor.supervisor import Supervisor
from tonus.runtime.supervisor.wiring import Wiring

MS = 1_000_000


N = 8


STRICT = {
    "supervisor.period_ms": 2,
    "supervisor.timeout_ms": 22,
    "supervisor.patience_ms": 5,
    "supervisor.policy": "use",
}


def claim(state: State = State.ACTIVE, at_ms: float = 100.0, **given: Any) -> Claim:
    tension = np.full(N, 45.0)
    zero = np.zeros(N)
    tare, given_up = np.zeros(N + 1), np.zeros(N, bool)
    found = Claim(
        round(at_ms * MS), state, zero, tension, tension, tare, 0.0, 3210.0, given_up, zero
    )
    return replace(found, **given)


def seen(at_ms: float = 100.0, said: Claim | None = None, **given: Any) -> Observation:
    """Everything in order at ``at_ms``, but for what is given."""
    said = claim(at_ms=at_ms) if said is None else said
    found = Observation(
        now_ns=round(at_ms * MS),
        axes=np.arange(N),
        enabled=np.ones(N, bool),
        useless=np.zeros(N, bool),
        told=np.zeros(N, bool),
        measured_age=np.zeros(N),
        channel_age=np.zeros(N),
        torque_age=np.zeros(N),
        same=np.zeros(N, np.int64),
        mille=np.full(N, 100 * (said.state in ARMED)),
        pulled=np.full(N, said.state in ARMED),
        limited=np.zeros(N, bool),
        torque=np.full(N, 45.0),
        torques=np.full((2, N), 45.0),
        rate=np.zeros(N),
        travel=np.full(N, np.nan),
        momentum=np.zeros(N),
        tension=np.full(N, 45.0),
        contact=0.0,
        cell_age=np.zeros(N),
        contact_age=0.0,
        defective=np.zeros(N, bool),
        contact_defective=False,
        unexplained=np.zeros(N),
        mean_torque=np.full(N, 45.0),
        motion=np.zeros(N),
        most_torque=np.full(N, 45.0),
        incredible=np.zeros(N, bool),
        swing=np.full(N, 0.2),
        jolt=np.zeros(N),
        claims=[said],
        claim=said,
        unlogged=np.zeros(N, bool),
        late=np.zeros(N, bool),
        off_bus=np.zeros(N),
        beating=np.ones(N, bool),
        together=np.arange(N) // 2 == np.arange(N)[:, None] // 2,
    )
    if "mille" in given:
        given.setdefault("pulled", given["mille"] != 0)
    if "torque" in given:
        given.setdefault("torques", np.tile(given["torque"], (2, 1)))
    return replace(found, **given)


def at(row: int, value: float, others: float = 0.0) -> Any:
    found = np.full(N, others)
    found[row] = value
    return found


def judged(config: Config, *looks: Observation) -> list[Violation | None]:
    assert config.supervisor is not None
    judge = Judge(config, config.supervisor)
    return [judge(look) for look in looks]


def lasting(config: Config, for_ms: float, state: State = State.ACTIVE, **given: Any) -> Any:
    """The verdict at the end of a condition that lasts."""
    first = seen(100.0, claim(state, 100.0), **given)
    last = seen(100.0 + for_ms, claim(state, 100.0 + for_ms), **given)
    return judged(config, first, last)[-1]


class FakeBus(can.BusABC):
    """Gives what it is told, and keeps what is sent."""

    def __init__(self) -> None:
        self.waiting: list[can.Message] = []
        self.sent: list[can.Message] = []
        self.broken = self.closed = False
        super().__init__("fake")

    def shutdown(self) -> None:
        self.closed = True
        super().shutdown()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        assert timeout == 0, "it has no time to wait"
        if self.broken:
            raise can.CanOperationError("gone")
        return (self.waiting.pop(0) if self.waiting else None), True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        del timeout
        if self.broken:
            raise can.CanOperationError("gone")
        self.sent.append(msg)


class EchoBus(FakeBus):
    """One that tells what it has sent, once the test lets it out of the queue."""

    def __init__(self) -> None:
        super().__init__()
        self.queue: list[can.Message] = []
        self.full = False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.full:
            raise can.CanOperationError("no room")
        super().send(msg, timeout)
        self.queue.append(msg)

    def let_out(self) -> None:
        self.waiting += self.queue
        self.queue.clear()


class Stage:
    """The frames of every axis and cell, at times of the test's own."""

    def __init__(self, config: Config) -> None:
        assert config.supervisor is not None
        self.wiring = Wiring(config)
        self.heard: dict[tuple[str, int], Heard] = {}
        for axis in self.wiring.axes:
            self.heard[axis.channel, axis.sent] = Heard((axis.torque,), None, axis.controlword)
            self.heard[axis.channel, axis.received] = Heard((axis.position,), axis.statusword)
            self.heard[axis.channel, axis.sync] = Heard(())
        for cell in self.wiring.cells:
            self.heard[cell.channel, cell.received] = Heard((cell.force,))
            self.heard[cell.channel, cell.emergency] = Errors(())
        self.observe = Observer(self.wiring, config.supervisor, config.robot.contact_cell, MS)

    def tick(
        self, now_ns: int, *, newton: float, metre: float, force: float, on: bool = True
    ) -> None:
        """``on``: drives are told to have power, and have it."""
        controlword, statusword = (0x0F, 0x0237) if on else (0x00, 0x0240)
        for axis in self.wiring.axes:
            assert axis.newton is not None
            mille = round(newton / axis.newton) & 0xFFFF
            sent = mille << axis.torque.shift | controlword
            self.heard[axis.channel, axis.sent].take([sent], now_ns)
            place = round(metre / axis.metre) & 0xFFFFFFFF
            word = place << axis.position.shift | statusword
            self.heard[axis.channel, axis.received].take([word], now_ns)
            self.heard[axis.channel, axis.sync].take([0], now_ns)
        for cell in self.wiring.cells:
            self.heard[cell.channel, cell.received].take([round(force / cell.newton)], now_ns)


class Watchdog:
    """A supervisor with a bus for each channel, and what it is given."""

    def __init__(
        self,
        config: Config,
        bus: type[FakeBus] = FakeBus,
        clock: Callable[[], int] | None = None,
    ) -> None:
        self.buses: list[FakeBus] = []
        self.now_ms = 0.0
        self._bus = bus
        self.records: list[tuple[int, Any]] = []
        self.state = State.SAFE_STOP
        self._powered, self.resets = False, True
        """the operator resets again and again as long as nothing is enabled"""
        self._reset = self.stuck = False
        self.supervisor = Supervisor(config, self._new, self._open, clock)
        self.wiring = Wiring(config)

    def _open(self, *_: Any) -> can.BusABC:
        self.buses.append(self._bus())
        return self.buses[-1]

    def _new(self) -> New:
        new, self.records = self.records, []
        return [stamp for stamp, _ in new], np.array([record for _, record in new], cycle_dtype(N))

    def boot(self, but: tuple[str, int] | None = None) -> None:
        """Every device boots, ``but`` one; the next step sees it."""
        place = {channel: number for number, (_, channel, _) in enumerate(self.wiring.channels)}
        devices = (*self.wiring.axes, *self.wiring.cells)
        for channel, heartbeat in sorted({(each.channel, each.heartbeat) for each in devices}):
            if (channel, heartbeat) != but:
                told = can.Message(arbitration_id=heartbeat, is_extended_id=False, data=b"\0")
                self.buses[place[channel]].waiting.append(told)

    def step(
        self,
        now_ms: float,
        *,
        enabled: bool,
        tick: bool = True,
        deaf: Any = (),
        interrupted: bool = False,
        beats: Any = (),
        everywhere: bool = False,
        powered: Any = (),
    ) -> list[tuple[int, bytes]]:
        """What the first channel was sent in this step. Identifiers in ``deaf`` do not arrive; on
        the other channels no drive is enabled, unless ``everywhere``. ``interrupted``: all drives
        were off before. ``beats``: heartbeats of drives, axis and state each. ``powered``: axes
        whose process data tell them to have power, whatever they answer."""
        place = {channel: number for number, (_, channel, _) in enumerate(self.wiring.channels)}
        frames = {
            (cell.channel, cell.received): bytes(cell.received_bytes) for cell in self.wiring.cells
        }
        for axis in self.wiring.axes:
            on = enabled and (everywhere or place[axis.channel] == 0)
            word = 0x0237 if on else 0x0240
            data = word.to_bytes(2, "little") + bytes(axis.received_bytes - 2)
            frames[axis.channel, axis.received] = data
            told = 0
            if axis.number in powered and axis.controlword is not None:
                told = 0x0F << axis.controlword.shift
            frames[axis.channel, axis.sent] = told.to_bytes(axis.sent_bytes, "little")
        frames |= {(axis.channel, axis.sync): b"" for axis in self.wiring.axes}
        off = {
            (axis.channel, axis.received): (0x0240).to_bytes(axis.received_bytes, "little")
            for axis in self.wiring.axes
        }
        for (channel, identifier), data in [*(off.items() if interrupted else ()), *frames.items()]:
            if (channel, identifier) not in deaf:
                self.buses[place[channel]].waiting.append(
                    can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
                )
        for number, state in beats:
            axis = self.wiring.axes[number]
            beat = can.Message(
                arbitration_id=axis.heartbeat, is_extended_id=False, data=bytes([state])
            )
            self.buses[place[axis.channel]].waiting.append(beat)
        if tick:
            # Power comes with control, and a stop is of what was controlled.
            begins = enabled and not self._powered
            self._reset = self.resets and not (enabled or self._reset)
            states = [(self.state, self._reset)]
            if begins:
                states.insert(0, (State.REFERENCING, False))
            elif self._reset and broken(self) not in (None, Requirement.COMMANDED):
                # A daemon takes a reset in FAULT, which leads to STANDBY. What follows from FAULT
                # itself is the test's.
                states = [(State.FAULT, False), (State.STANDBY, True), (self.state, False)]
            for place, (state, reset) in enumerate(states):
                record = np.zeros(1, cycle_dtype(N))
                record["state"]["state"] = state
                if reset or self.stuck:
                    record["state"]["operator"] = Operator.RESET
                record["timing"]["tick"] = round(now_ms * 1000) + place
                before_ms = 0.6 * (len(states) - 1 - place)
                self.records.append((round((now_ms - before_ms) * MS), record[0]))
        self._powered = enabled
        before, self.now_ms = len(self.buses[0].sent), now_ms
        self.supervisor.step(round(now_ms * MS))
        assert not any(message.is_extended_id for bus in self.buses for message in bus.sent)
        return [(m.arbitration_id, bytes(m.data)) for m in self.buses[0].sent[before:]]

    def steps(self, start: int, stop: int, **given: Any) -> Iterator[list[tuple[int, bytes]]]:
        for now in range(start, stop, 2):
            yield self.step(now, **given)


def broken(watchdog: Watchdog) -> Requirement | None:
    """What it stopped the robot for."""
    found = watchdog.supervisor.violation
    return None if found is None else found.requirement
