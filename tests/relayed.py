"""Runs on EtherCAT with a supervisor that holds the relay of the STO inputs, in which the daemon is
changed from some instant on; the lab's relay and drives are looked at in every tick."""

from __future__ import annotations

from dataclasses import dataclass, field

from tests.supervised import Run
from tonus.config.schema.root import Config
from tonus.config.schema.sto_relay import StoRelay
from tonus.runtime.timing import clock
from tonus.sim.devices.output_node import OutputNode

PATH = "config/ethercat.yaml"
STO = 0x8A88
"""0x603F of an EPOS4 that lost the voltage of its STO inputs while it had power"""


def relay_of(config: Config) -> StoRelay:
    assert config.relay is not None
    return config.relay


@dataclass
class RelayRun(Run):
    """`stopped_ns`: of each drive, by axis plus 1, the first tick at which it has no power and the
    error of STO."""

    off_ns: int = 0
    """the first tick at which the node's output is off after the change"""
    open_ns: int = 0
    """the same of the contacts"""
    released: list[bool] = field(default_factory=list)
    """by the mirror contact, in each tick"""

    @property
    def off_ms(self) -> float:
        return (self.off_ns - self.changed_ns) * 1e-6 if self.off_ns else float("inf")

    @property
    def open_ms(self) -> float:
        return (self.open_ns - self.changed_ns) * 1e-6 if self.open_ns else float("inf")

    def node(self) -> OutputNode:
        relay, lab = relay_of(self.config), self._playing.lab
        assert lab is not None
        device = lab.nodes[relay.channel, relay.node_id].device
        assert isinstance(device, OutputNode)
        return device

    def _channels(self) -> list[str]:
        return [relay_of(self.config).channel]

    def _listen(self) -> None:
        super()._listen()
        now_ns, lab = clock.now_ns(), self._playing.lab
        assert lab is not None
        lab.advance(now_ns)
        node = self.node()
        self.released.append(bool(node.inputs & 1))
        if not self.changed_ns:
            return
        if not node.outputs and not self.off_ns:
            self.off_ns = now_ns
        if node.inputs & 1 and not self.open_ns:
            self.open_ns = now_ns
        for drive in lab.drives:
            if not drive.enabled and drive.objects.number(0x603F, 0) == STO:
                assert drive.axis is not None
                self.stopped_ns.setdefault(drive.axis + 1, now_ns)
