"""The cable from slave to slave: where it is broken, and whom frames reach from either end."""

from __future__ import annotations

from tonus.sim.ethercat.slaves import registers as reg
from tonus.sim.ethercat.slaves.slave import Slave

_LINK = 0x0001 | 0x0010 | 0x0200 | 0x5000
"""DL status: a working slave with a link at port 0, ports 2 and 3 closed"""
_LINK_BEHIND, _CLOSED_BEHIND = 0x0820, 0x0400
_LOST_LINKS = 0x311


class Cable:
    """Joins ``slaves``, a list that may still grow; ``ring``: the last one leads back to a second
    port (1)."""

    def __init__(self, slaves: list[Slave], *, hop_ns: int, ring: bool) -> None:
        self.ring = ring
        self.reach: tuple[list[Slave], list[Slave]] = ([], [])
        """slaves that a frame passes from either port, the nearest first"""
        self.whole = True
        """nothing turns a frame back"""
        self._slaves, self._hop_ns = slaves, hop_ns
        self._breaks: set[int] = set()  # each before the slave of this place, from 0

    def cut(self, place: int) -> None:
        """Break it before the slave of this place, from 0: only so many answer. A ring has one
        more, back from the last."""
        self._breaks.add(place)
        self.rewire()

    def mend(self, place: int | None = None) -> None:
        """Put one break right, or all."""
        self._breaks -= {place} if place is not None else set(self._breaks)
        self.rewire()

    def switch(self, place: int, *, on: bool) -> None:
        """Take the power of a slave, or give it back; its ports are closed without. Raises
        `LabError`."""
        slave = self._slaves[place]
        if on and not slave.powered:
            slave.switch_on()
        elif not on:
            slave.switch_off()
        self.rewire()

    def exit(self, port: int) -> int:
        """Where a frame that came in at a port comes out."""
        return 1 - port if self.ring and self.whole else port

    def reachable(self, place: int) -> bool:
        """Whether a master's frames come to a slave."""
        slave = self._slaves[place]
        return slave in self.reach[0] or (self.ring and slave in self.reach[1])

    def rewire(self) -> None:
        """Work out whom frames reach, and let the slaves see their links."""
        slaves, cuts = self._slaves, self._cuts()
        self.whole = not cuts
        near = slaves[: min(cuts)] if cuts else list(slaves)
        far = slaves[max(cuts) :] if cuts and self.ring else []
        self.reach = (near, far)
        last = len(slaves) - 1
        for place, slave in enumerate(slaves):
            memory = slave.controller.memory
            linked = place + 1 not in cuts and (place < last or self.ring)
            if memory[reg.STATUS_DL] & 0x20 and not linked:
                memory[_LOST_LINKS] = min(memory[_LOST_LINKS] + 1, 0xFF)
            word = _LINK | (_LINK_BEHIND if linked else _CLOSED_BEHIND)
            memory[reg.STATUS_DL], memory[reg.STATUS_DL + 1] = word & 0xFF, word >> 8
        for group in self.reach:
            self._measure(group)

    def _cuts(self) -> set[int]:
        """Where frames turn back."""
        cuts = {place for place in self._breaks if place < len(self._slaves) + self.ring}
        for place, slave in enumerate(self._slaves):
            if not slave.powered:
                cuts |= {place, place + 1}
        return cuts

    def _measure(self, group: list[Slave]) -> None:
        hop_ns, last = self._hop_ns, len(group) - 1
        for number, slave in enumerate(group):
            slave.arrival_ns = number * hop_ns
            slave.return_ns = (2 * last - number) * hop_ns if number < last else None
