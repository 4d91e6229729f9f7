"""python-canopen's CiA 402 node as these tests use it, on the EDS file shipped with the drive."""

from __future__ import annotations

import queue
import time  # noqa: TID251 - another process keeps this lab's time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import canopen
from canopen.profiles.p402 import BaseNode402
from canopen.sdo import SdoAbortedError

import tonus.sim.devices

Networks = dict[str, canopen.Network]
EDS = Path(tonus.sim.devices.__path__[0]) / "epos4.eds"
CST = "CYCLIC SYNCHRONOUS TORQUE"
PATIENCE_S = 3.0
"""for an answer of a lab whose host has other work as well"""
LATE_BEATS = 3
"""heartbeats that were under way when a reset was sent"""


@cache
def dictionary(node: int) -> canopen.ObjectDictionary:
    """A drive's objects as the client knows them."""
    return canopen.import_od(str(EDS), node)


def eventually(holds: Callable[[], bool], within: float = PATIENCE_S) -> bool:
    """Whether something comes true in time."""
    end = time.monotonic() + within
    while not holds():
        if time.monotonic() > end:
            return False
        time.sleep(0.002)
    return True


class Drive(BaseNode402):
    """A drive on a network, with what it says of itself kept from the beginning."""

    def __init__(self, network: canopen.Network, number: int) -> None:
        super().__init__(number, dictionary(number))
        network.add_node(self)
        self.sdo.RESPONSE_TIMEOUT = PATIENCE_S
        self.beats: queue.SimpleQueue[int] = queue.SimpleQueue()
        self.emergencies: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.nmt.add_heartbeat_callback(self.beats.put)
        self.emcy.add_callback(self.emergencies.put)

    def command(self, word: str) -> None:
        """An NMT command, and the boot-up that answers a reset."""
        while not self.beats.empty():
            self.beats.get()
        self.nmt.state = word
        if word.startswith("RESET"):
            beats = (self.beats.get(timeout=PATIENCE_S) for _ in range(1 + LATE_BEATS))
            assert 0 in beats

    def reset(self) -> None:
        """As it was delivered, with nothing to remember."""
        self.command("RESET")
        self.sdo[0x1003][0].raw = 0
        self.tpdo_values.clear()

    def leave(self) -> None:
        """Stop what runs, put back what was saved, and go."""
        for pdo in self.rpdo.values():
            pdo.stop()
        self.command("RESET")
        self.sdo.download(0x1011, 1, b"load")
        self.command("RESET")
        network = self.network
        del network[self.id]

    def number(self, index: int, sub: int = 0) -> int:
        """An unsigned object by SDO, whatever the dictionary says of it."""
        return int.from_bytes(self.sdo.upload(index, sub), "little")

    def emergency(self) -> tuple[int, int]:
        """Code and register of the next emergency."""
        entry = self.emergencies.get(timeout=PATIENCE_S)
        return entry.code, entry.register

    def refused(self, act: Callable[[], object]) -> int:
        """Abort code of an access, 0 if it was granted."""
        try:
            act()
        except SdoAbortedError as abort:
            return int(abort.code)
        return 0

    def map_torque(self, transmission: int) -> None:
        """RPDO1: controlword, target torque; TPDO1: statusword, position, torque; no others."""
        self.command("PRE-OPERATIONAL")
        self.tpdo.read()
        self.rpdo.read()
        for number in (2, 3, 4):
            self.rpdo[number].enabled = False
            self.rpdo[number].save()
        for pdo, objects in (
            (self.rpdo[1], (0x6040, 0x6071)),
            (self.tpdo[1], (0x6041, 0x6064, 0x6077)),
        ):
            pdo.clear()
            for index in objects:
                pdo.add_variable(index)
            pdo.trans_type = transmission
            pdo.enabled = True
            pdo.save()
        self.setup_402_state_machine(read_pdos=False)
