"""The supervisor of a run: on the loop of the daemon in virtual time, else a process of its own."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import can
import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.root import Config
from tonus.runtime.ports import Ring
from tonus.runtime.signals import cycle_dtype
from tonus.runtime.supervisor.record import New
from tonus.runtime.supervisor.supervisor import Supervisor
from tonus.runtime.supervisor.wiring import Wiring
from tonus.runtime.timing.clock import now_ns
from tonus.tools.errors import ToolError

_GATHER_MS = 2
"""A lab in real time has the processor for little more than the daemon's frames."""
_KEPT = 256
"""records, more than there are between two looks"""


def wanted(config: Config) -> bool:
    """Whether a run is supervised: there is a supervisor, and a drive on CAN that it acts on, or a
    relay."""
    supervisor = config.supervisor
    if supervisor is None or supervisor.policy == "off":
        return False
    return config.relay is not None or bool(Wiring(config).axes)


def without_relay(config: Config) -> Config:
    """For a run that nobody supervises, with the relay bridged."""
    return config.model_copy(update={"sto_relay": None})


def require_reach(config: Config) -> None:
    """Raises `ToolError` where a supervisor is required and has no drive to act on, and where there
    is a relay beside drives on CAN."""
    supervisor = config.supervisor
    if config.relay is not None and Wiring(config).axes:
        raise ToolError(
            "sto_relay is for robots without a drive on CAN, whose frames the supervisor does not "
            "read: remove it"
        )
    if supervisor is not None and supervisor.policy == "require" and not wanted(config):
        raise ToolError(
            "supervisor.policy is require, and no drive is on CAN, where it acts: add sto_relay: "
            "!include sto_relay.yaml, or write supervisor.policy under relaxed, and set it to off"
        )


def open_bus(interface: str, channel: str, bitrate: int) -> can.BusABC:
    """A bus of the supervisor's own on a channel, which tells what it has sent. Raises
    `ToolError`."""
    lab: dict[str, Any] = {"gather_ms": _GATHER_MS} if interface == "tonus" else {}
    try:
        return can.Bus(
            interface=interface, channel=channel, bitrate=bitrate, receive_own_messages=True, **lab
        )
    except (can.CanError, OSError, ValueError, ImportError) as error:
        raise ToolError(
            f"{channel} cannot be opened on interface {interface}: {error}; `tonus doctor` says "
            "what this host has"
        ) from error


class Overheard:
    """A ring whose records the supervisor of the same process takes as well."""

    def __init__(self, ring: Ring, cables: int) -> None:
        self._ring = ring
        self._dtype = cycle_dtype(cables)
        self._stamps: deque[int] = deque(maxlen=_KEPT)
        self._records: deque[bytes] = deque(maxlen=_KEPT)

    def publish(self, payload: NDArray[np.void], stamp_ns: int) -> None:
        self._ring.publish(payload, stamp_ns)
        self._stamps.append(stamp_ns)
        # By way of bytes: numpy copies a record field by field, in 35 us instead of 0.3.
        self._records.append(payload.tobytes())

    def __call__(self) -> New:
        """New records, once."""
        new = list(self._stamps), np.frombuffer(b"".join(self._records), self._dtype)
        self._stamps.clear()
        self._records.clear()
        return new


@contextmanager
def supervised(config: Config, ring: Ring) -> Iterator[Ring]:
    """In virtual time: the ring to give to the daemon, while its supervisor, if it has one, works
    on the running loop. Raises `ToolError` where a channel cannot be opened, and afterwards what
    the supervisor itself died of."""
    require_reach(config)
    if not wanted(config):
        yield ring
        return
    overheard = Overheard(ring, config.robot.cables)
    try:
        supervisor = Supervisor(config, overheard, open_bus)
    except (can.CanError, OSError) as error:
        raise ToolError(f"the supervisor cannot listen: {error}") from error
    period_ns = supervisor.settings.period_ms * 1_000_000
    # Between two ticks: what a tick has sent and recorded is seen as of one tick.
    due_ns = now_ns() // period_ns * period_ns + config.control.rates.period_ns // 2
    task = asyncio.get_running_loop().create_task(_again(supervisor, due_ns, period_ns))
    try:
        yield overheard
    finally:
        died = task.exception() if task.done() else None
        task.cancel()
        supervisor.close()
        if died is not None:
            raise died


async def _again(supervisor: Supervisor, due_ns: int, period_ns: int) -> None:
    loop = asyncio.get_running_loop()
    while True:
        due_ns += period_ns
        arrived = loop.create_future()
        loop.call_at(due_ns * 1e-9, arrived.set_result, None)
        await arrived
        supervisor.step(now_ns())
