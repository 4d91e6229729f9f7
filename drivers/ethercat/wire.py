"""What carries a segment's frames: the door between the fieldbus and its two masters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from tonus.drivers.cia301.setting import ObjectAccess
from tonus.drivers.ethercat.status import SlaveStatus

FIRST_STATION = 0x1001
"""Station addresses follow the order of the cable from here, as SOEM sets them."""


@dataclass(frozen=True)
class Found:
    """What a slave says it is."""

    vendor: int
    product: int
    revision: int
    name: str = ""

    def __str__(self) -> str:
        text = f"vendor 0x{self.vendor:08X} product 0x{self.product:08X}"
        text += f" revision 0x{self.revision:08X}"
        return f"{text} {self.name}" if self.name else text


@dataclass(frozen=True)
class Sizes:
    """Bytes of process data of one slave."""

    outputs: int
    inputs: int


class Wire(Protocol):
    """A master. Slaves are numbered from 0 in the order of the cable.

    What is asynchronous may take long and is used before the ticks or beside them; the rest is for
    a tick and never waits longer than the configured receive timeout.
    """

    inputs: list[bytes]
    """of each slave, as the last `receive` brought them; of one that took no part, what was sent"""
    reference_ns: int | None
    """the reference clock when the last frame passed it; None without distributed clocks"""

    @property
    def open_after(self) -> int | None:
        """Slaves on the near side of an open ring, as `looked` last had it; None: closed, or a
        line."""

    async def scan(self) -> list[Found]:
        """Open the interface, count the slaves, bring them to PREOP. Raises `BringUpError`."""

    def objects(self, slave: int) -> ObjectAccess: ...

    async def map(self, sizes: Sequence[Sizes], watchdog_ms: int) -> None:
        """Sync managers, their watchdog, and FMMUs for these process data. Raises `BringUpError`
        when a slave's own mapping says otherwise."""

    async def align_clocks(self) -> int:
        """Measure delays, set offsets: one time in all slaves. Returns by how many ns it is ahead
        of the loop's clock. Raises `BringUpError` when there is no clock."""

    async def start_sync(self, slave: int, period_ns: int, phase_ns: int) -> None:
        """SYNC0 whenever the common time is ``phase_ns`` after a multiple of ``period_ns``."""

    async def reconfigure(self, slave: int) -> None:
        """Bring a slave that lost everything back to PREOP, under its address. Raises
        `DriverError`."""

    async def remap(self, slave: int) -> None:
        """Sync managers, watchdog and FMMUs of one slave, as `map` set them."""

    def send(self, outputs: Sequence[bytes]) -> int:
        """Process data, and with it the reference clock to all. Returns when: ns of
        the loop's clock."""

    def receive(self) -> int | None:
        """The working counter of what `send` sent, None if it did not come back."""

    def look(self) -> None:
        """Ask every slave for its state and its clock."""

    def looked(self) -> list[SlaveStatus | None] | None:
        """The answer to `look`, None if there is none (yet); within it None for each slave that
        did not take part."""

    def control(self, words: Mapping[int, int]) -> None:
        """Write AL control of some slaves, in one frame and without waiting for anything."""

    def close(self) -> None: ...
