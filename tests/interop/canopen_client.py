"""python-canopen's CiA 402 node as these tests use it, with an object dictionary of its own.

The dictionary is the EDS file that is shipped with the emulated drive; without one, the objects
that the tests touch, typed by hand from CiA 301 and 402.
"""

from __future__ import annotations

import queue
import time  # noqa: TID251 - another process keeps this lab's time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import canopen
from canopen.objectdictionary import ODRecord, ODVariable
from canopen.objectdictionary import datatypes as types
from canopen.profiles.p402 import BaseNode402
from canopen.sdo import SdoAbortedError

import sim.devices

Networks = dict[str, canopen.Network]
EDS = Path(sim.devices.__path__[0]) / "epos4.eds"
CST = "CYCLIC SYNCHRONOUS TORQUE"
_U8, _U16, _U32 = types.UNSIGNED8, types.UNSIGNED16, types.UNSIGNED32
_I8, _I16, _I32 = types.INTEGER8, types.INTEGER16, types.INTEGER32
_VARIABLES = {
    0x1000: _U32,
    0x1001: _U8,
    0x1008: types.VISIBLE_STRING,
    0x1017: _U16,
    0x6007: _I16,
    0x603F: _U16,
    0x6040: _U16,
    0x6041: _U16,
    0x605A: _I16,
    0x6060: _I8,
    0x6061: _I8,
    0x6064: _I32,
    0x6065: _U32,
    0x6071: _I16,
    0x6076: _U32,
    0x6077: _I16,
    0x6081: _U32,
    0x60B2: _I16,
    0x6502: _U32,
}
_RECORDS = {
    0x1003: (_U8, *(_U32,) * 5),
    0x1010: (_U8, _U32),
    0x1011: (_U8, _U32),
    0x1016: (_U8, _U32, _U32),
    0x1018: (_U8, *(_U32,) * 4),
    0x3001: (_U8, _U32, _U32, _U8, _U16, _U32),
    **{0x1400 + n: (_U8, _U32, _U8) for n in range(4)},
    **{0x1600 + n: (_U8, *(_U32,) * 12) for n in range(4)},
    **{0x1800 + n: (_U8, _U32, _U8, _U16) for n in range(4)},
    **{0x1A00 + n: (_U8, *(_U32,) * 12) for n in range(4)},
}


def _variable(index: int, sub: int, kind: int) -> ODVariable:
    made = ODVariable(f"object {index:04X}:{sub}", index, sub)
    made.data_type = kind
    return made


@cache
def dictionary(node: int) -> canopen.ObjectDictionary:
    """A drive's objects as the client knows them."""
    if EDS.exists():
        return canopen.import_od(str(EDS), node)
    objects = canopen.ObjectDictionary()
    for index, kind in _VARIABLES.items():
        objects.add_object(_variable(index, 0, kind))
    for index, kinds in _RECORDS.items():
        record = ODRecord(f"record {index:04X}", index)
        for sub, kind in enumerate(kinds):
            record.add_member(_variable(index, sub, kind))
        objects.add_object(record)
    return objects


def eventually(holds: Callable[[], bool], within: float = 3.0) -> bool:
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
            assert self.beats.get(timeout=3) == 0

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
        entry = self.emergencies.get(timeout=3)
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
