"""No frame, however odd, stops a node: it goes on answering, in a defined state."""

from __future__ import annotations

import random
import struct

import can
import pytest
from lab_bench import Bench

from sim.devices.cia402 import State
from sim.devices.epos4_objects import dictionary

OBJECTS = sorted(dictionary(1).entries)
OBJECTS += [(index, sub) for index in (0x1400, 0x1600, 0x1800, 0x1A00) for sub in range(5)]
OBJECTS += [(0x1016, 1), (0x1017, 0), (0x1029, 1)]


def odd_frame(choose: random.Random) -> can.Message:
    kind = choose.random()
    if kind < 0.5:
        # An SDO request that is nearly right, with values at the ends of their types.
        index, sub = choose.choice(OBJECTS)
        command = choose.choice([0x2F, 0x2B, 0x23, 0x22, 0x27, 0x40, 0x21, 0x20, 0x60, 0x70, 0xA0])
        value = choose.choice(
            [0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0xFFFFFFFF, 0x60640020, 0x80000201]
        )
        data = struct.pack("<BHBI", command, index, sub, value)
        return can.Message(arbitration_id=0x601, is_extended_id=False, data=data)
    if kind < 0.6:
        data = bytes((choose.choice([1, 2, 0x80, 0x81, 0x82, 0x55]), choose.choice([0, 1, 2])))
        return can.Message(arbitration_id=0, is_extended_id=False, data=data)
    identifier = choose.choice([0, 0x80, 0x201, 0x301, 0x401, 0x501, 0x601, 0x611, 0x77F, 0x181])
    if kind > 0.9:
        identifier = choose.getrandbits(11)
    data = choose.randbytes(choose.randint(0, 8))
    remote = choose.random() < 0.05
    return can.Message(
        arbitration_id=identifier,
        is_extended_id=choose.random() < 0.05,
        is_remote_frame=remote,
        dlc=len(data),
        data=None if remote else data,
    )


@pytest.mark.parametrize("seed", range(4))
def test_odd_frames(seed: int) -> None:
    choose = random.Random(seed)
    with Bench() as bench:
        for _ in range(1500):
            bench.buses["can0"].send(odd_frame(choose))
            bench.wait(choose.choice([0.2, 0.5, 1.0]))
            assert bench.lab.drives[0].state in State
        bench.send("can0", 0, b"\x81\x00")
        bench.wait(20)
        for node, kind in ((1, 0x00020192), (2, 0x00020192), (17, 0x00020194)):
            assert bench.upload("can0", node, 0x1000, 0) == struct.pack("<I", kind)
        assert bench.lab.drives[0].statusword() & 0x6F == State.SWITCH_ON_DISABLED
