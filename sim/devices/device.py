"""What a bus needs of a device: its objects, its process data, its errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from tonus.sim.devices.objects import ObjectDictionary

Reader = Callable[[], float]
Writer = Callable[[int], None]
ErrorSink = Callable[[int, int], None]
"""Takes an error code and the error register; code 0: no error remains."""


@dataclass(frozen=True)
class PdoDefault:
    """A PDO as a device has it from the factory; identifier base and flags, mapping words."""

    cob_id: int
    transmission: int
    mapping: tuple[int, ...]


class Device(Protocol):
    """A device without a bus. Process data are read at the instant of the last sample."""

    objects: ObjectDictionary
    on_error: ErrorSink

    @property
    def axis(self) -> int | None:
        """Of a drive."""

    @property
    def receive_pdos(self) -> tuple[PdoDefault, ...]: ...
    @property
    def transmit_pdos(self) -> tuple[PdoDefault, ...]: ...

    longest_mapping: int
    """entries one PDO may have"""
    consumers: int
    """heartbeat consumer entries"""
    event_timer: bool
    """whether a PDO can be sent by time"""
    error_behaviour: bool
    """whether there is 0x1029"""

    def sample(self, now_ns: int) -> None:
        """Take the process data of this instant."""

    def reader(self, index: int, subindex: int) -> Reader: ...

    def place(self, index: int, subindex: int) -> int | None:
        """Where in `tonus.sim.devices.samples.Samples.values` an object's value stands, as
        `reader` gives it; None: nowhere."""

    def writer(self, index: int, subindex: int) -> Writer: ...

    def received(self, now_ns: int) -> None:
        """Process data have been written with `writer`s, all of one message."""

    def set_operational(self, operational: bool) -> None:
        """The bus has started, or no longer runs, process data."""

    def fail(self, code: int) -> None:
        """Raise an error, the device's own or one its bus has noticed."""

    def reset(self) -> None:
        """As at switch-on, but for the objects of the bus."""

    def power_cycle(self) -> None:
        """The supply goes and comes back."""

    def communication_reset(self) -> None: ...
