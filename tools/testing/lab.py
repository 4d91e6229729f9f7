"""A lab for one test: in this process, in virtual time, moved on by the test alone."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

import can
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from tonus.config.faults import KINDS
from tonus.config.schema.faults import FAULT, Fault
from tonus.config.schema.lab import LabScript
from tonus.config.schema.root import Config
from tonus.sim.lab.engine import Lab
from tonus.sim.lab.faults import ActiveFault
from tonus.sim.lab.truth import truth_dtype
from tonus.tools.errors import ToolError
from tonus.tools.run.supervision import without_relay
from tonus.tools.testing.arguments import number
from tonus.tools.testing.waiting_bus import WaitingBus

if TYPE_CHECKING:
    from tonus.tools.testing.canopen_network import VirtualNetwork

_MS, _SECOND = 1_000_000, 1_000_000_000
_STEP_NS = 20_000
"""less than the shortest frame takes at 1 Mbit/s"""


class VirtualLab:
    """Emulated devices and the model of the robot. Nothing happens by itself: time goes on in
    `advance`, and while a bus or a CANopen network of this lab waits for something."""

    def __init__(self, config: Config, script: LabScript | None = None, *, seed: int = 1) -> None:
        """``script`` as in `tonus.Lab`. A relay of the configuration is bridged: nobody would hold
        it. Raises `LabError`."""
        self.config, self.seed = config, seed
        self._truth = np.zeros(1, truth_dtype(config.robot.cables))
        self.lab: Lab = Lab(
            without_relay(config),
            script or LabScript(),
            seed=seed,
            clock=lambda: self.lab.now_ns,
            truth=self._note,
        )
        """the lab itself, with all it offers beside this"""
        self.given: list[tuple[float, Fault]] = []
        """each fault of `fault`, with the time in s at which it strikes"""
        self._networks: list[VirtualNetwork] = []
        self._closing = ExitStack()
        self.lab.open()
        self._closing.callback(self.lab.close)

    @property
    def now(self) -> float:
        """s since the lab's start."""
        return self.lab.now_ns / _SECOND

    @property
    def truth(self) -> NDArray[np.void]:
        """The plant's true state at the last whole millisecond, a copy: a record () with the fields
        of ``/tonus/truth`` (docs/log.md), such as ``truth["tension"]`` (k,) in N."""
        record: NDArray[np.void] = self._truth.copy().reshape(())
        return record

    @property
    def faults(self) -> list[ActiveFault]:
        """The active ones, oldest first."""
        return self.lab.faults()

    def bus(self, channel: str, **options: Any) -> can.BusABC:
        """A python-can bus on a channel, such as "can0". Its ``recv`` waits in the lab's time.
        ``options`` as those of ``can.Bus(interface="tonus")``. Raises `ToolError` for a channel
        that this lab does not have, as a lab with EtherCAT has none."""
        if channel not in self.lab.channels:
            raise ToolError(f"bus {channel!r}: {self._no_bus}")
        bus = WaitingBus(channel, wait=self.wait, **options)
        self._closing.callback(bus.shutdown)
        return bus

    def canopen(self, channel: str) -> VirtualNetwork:
        """A python-canopen network on a channel, connected; whatever it waits for it waits for in
        the lab's time. Raises `ToolError` without python-canopen, and while another open lab has
        such a network."""
        try:
            from tonus.tools.testing.canopen_network import VirtualNetwork
            from tonus.tools.testing.virtual_waits import virtual_waits
        except ModuleNotFoundError as error:
            raise ToolError(
                "python-canopen is not installed; install it with: pip install tonus[test]"
            ) from error
        if not self._networks:
            self._closing.enter_context(virtual_waits(self))
        network = VirtualNetwork(self.bus(channel))
        self._networks.append(network)
        self._closing.callback(network.disconnect)
        return network

    def advance(self, ms: float) -> None:
        """Let so many ms of the lab's time pass. Raises `ToolError`."""
        number("advance", ms)
        if self._networks:
            self.wait(lambda: False, ms * 1e-3)
        else:
            self.lab.advance(self.lab.now_ns + round(ms * _MS))

    def wait(self, holds: Callable[[], bool], seconds: float) -> bool:
        """Let time pass from event to event until something holds, ``seconds`` at most. Whether it
        came to hold."""
        end_ns = self.lab.now_ns + round(seconds * _SECOND)
        while True:
            for network in self._networks:
                network.receive()
            if holds():
                return True
            now_ns = self.lab.now_ns
            if now_ns >= end_ns:
                return False
            self.lab.advance(min(end_ns, max(self._next_ns(), now_ns + _STEP_NS)))

    def _next_ns(self) -> int:
        """When something may arrive on a bus, or a device does something."""
        arrivals = (channel.next_ns() for channel in self.lab.channels.values())
        return min([self.lab.next_work_ns(), *arrivals])

    def fault(self, fault: Fault | str, **fields: Any) -> None:
        """Inject a fault: one of `tonus.faults`, or its kind with its fields (docs/faults.md).
        ``at``: s from now. Raises `ToolError` for fields that make no fault, `LabError` for one
        that is not possible in this lab."""
        one = made(fault, fields)
        self.lab.inject(one)
        self.given.append((self.now + one.at, one))

    @property
    def _no_bus(self) -> str:
        if self.lab.channels:
            return f"this lab has no such channel; choose one of {', '.join(self.lab.channels)}"
        return "this lab has no CAN bus; use truth, fault and advance, or tonus_run and tonus_held"

    def close(self) -> None:
        """Give the channels back; called at the end of the test."""
        self._closing.close()

    def _note(self, record: NDArray[np.void], stamp_ns: int) -> None:
        del stamp_ns
        self._truth[:] = record


def made(fault: Fault | str, fields: dict[str, Any]) -> Fault:
    """A fault by its kind and fields, or the one given. Raises `ToolError`."""
    __tracebackhide__ = True
    if not isinstance(fault, str):
        if not hasattr(fault, "kind"):
            raise ToolError(f"{fault!r} is no fault; give a kind, or one of tonus.faults")
        if fields:
            raise ToolError(f"fault {fault.kind}: its fields belong into its constructor")
        return fault
    if fault not in KINDS:
        close = get_close_matches(fault, KINDS, 1)
        guess = f"did you mean {close[0]}?" if close else "tonus fault list names them"
        raise ToolError(f"fault {fault}: there is no such kind; {guess}")
    try:
        return FAULT.validate_python({"kind": fault, **fields})
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"][1:]) or "kind"
        said = first["msg"][0].lower() + first["msg"][1:]
        remedy = f"tonus fault {fault} --help lists its fields"
        raise ToolError(f"fault {fault}: {key}: {said}; {remedy}") from None
