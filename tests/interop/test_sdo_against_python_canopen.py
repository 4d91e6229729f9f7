"""Our SDO client and our bring-up against python-canopen's LocalNode, an independent server."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import ExitStack, asynccontextmanager
from typing import Any

import can
import pytest
from canopen.objectdictionary import (
    UNSIGNED8,
    UNSIGNED16,
    UNSIGNED32,
    VISIBLE_STRING,
    ObjectDictionary,
)
from interop.local_nodes import dictionary, epos4, force_cell, local_nodes, robot_on

from tonus.config import Config
from tonus.drivers.canopen.channel import Channel
from tonus.drivers.canopen.channels import Channels
from tonus.drivers.canopen.master import CanopenFieldbus
from tonus.drivers.canopen.reception import Reception
from tonus.drivers.canopen.sdo import SdoClient
from tonus.drivers.errors import BringUpError, SdoAbortError, SdoError, SdoTimeoutError
from tonus.drivers.events import EventLog
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.timing.clock import RealTimeLoop

pytestmark = pytest.mark.wide


def served() -> ObjectDictionary:
    objects: dict[tuple[int, int], tuple[object, int, str]] = {
        (0x1008, 0): ("EPOS4 Compact 50/8 CAN", VISIBLE_STRING, "const"),
        (0x2000, 0): ("", VISIBLE_STRING, "rw"),
        (0x2001, 0): (0x11, UNSIGNED8, "rw"),
        (0x2002, 0): (0x2211, UNSIGNED16, "rw"),
        (0x2004, 0): (0x44332211, UNSIGNED32, "rw"),
        (0x2005, 0): (5, UNSIGNED8, "ro"),
        (0x2006, 0): (6, UNSIGNED8, "wo"),
        (0x2100, 1): (1, UNSIGNED8, "rw"),
    }
    return dictionary(objects)


@asynccontextmanager
async def client(channel: str, node_id: int, timeout_s: float = 2.0) -> AsyncIterator[SdoClient]:
    bus = can.Bus(interface="virtual", channel=channel)
    config = robot_on(channel).fieldbus
    reception = Reception(1, 8)
    made = Channel(0, bus, config, 1000, 3, lambda: 0, None, EventLog(), reception)
    wire = Channels((made,), lambda: 0, None, reception)
    sdo = SdoClient(lambda data: made.send(0x600 + node_id, data), timeout_s)
    made.handlers[0x580 + node_id] = sdo.receive

    async def pump() -> None:
        while True:
            wire.drain()
            await asyncio.sleep(0.0005)

    pumping = asyncio.create_task(pump())
    try:
        yield sdo
    finally:
        pumping.cancel()
        bus.shutdown()


def test_expedited_transfers_of_every_size() -> None:
    async def work() -> None:
        async with client("expedited", 5) as sdo:
            assert await sdo.read(0x2001, 0) == b"\x11"
            assert await sdo.read(0x2002, 0) == b"\x11\x22"
            assert await sdo.read(0x2004, 0) == b"\x11\x22\x33\x44"
            await sdo.write(0x2001, 0, b"\xaa")
            await sdo.write(0x2002, 0, b"\xaa\xbb")
            await sdo.write(0x2004, 0, b"\xaa\xbb\xcc\xdd")
            assert await sdo.read(0x2004, 0) == b"\xaa\xbb\xcc\xdd"

    with local_nodes("expedited", {5: served()}) as (node,):
        asyncio.run(work())
        assert node.sdo[0x2001].raw == 0xAA
        assert node.sdo[0x2002].raw == 0xBBAA


def test_segmented_transfers_both_ways() -> None:
    async def work() -> None:
        async with client("segmented", 5) as sdo:
            assert await sdo.read(0x1008, 0) == b"EPOS4 Compact 50/8 CAN"
            for size in (5, 6, 7, 8, 13, 14, 15, 100, 889):
                text = bytes(65 + n % 26 for n in range(size))
                await sdo.write(0x2000, 0, text)
                assert await sdo.read(0x2000, 0) == text

    with local_nodes("segmented", {5: served()}):
        asyncio.run(work())


def test_aborts_come_back_in_words() -> None:
    async def work() -> None:
        async with client("aborts", 5) as sdo:
            for call, code, words in (
                (sdo.read(0x5000, 0), 0x06020000, "object does not exist, reading 0x5000:0"),
                (sdo.read(0x2100, 9), 0x06090011, "subindex does not exist, reading 0x2100:9"),
                (sdo.write(0x2005, 0, b"\0"), 0x06010002, "write a read-only object"),
                (sdo.read(0x2006, 0), 0x06010001, "read a write-only object"),
                (sdo.write(0x2004, 0, b"\0"), 0x06070010, "length does not match"),
            ):
                with pytest.raises(SdoAbortError) as caught:
                    await call
                assert caught.value.code == code
                assert words in str(caught.value)
            assert await sdo.read(0x2001, 0) == b"\x11"

    with local_nodes("aborts", {5: served()}):
        asyncio.run(work())


def test_silence_times_out_and_the_next_transfer_is_not_disturbed() -> None:
    async def work() -> None:
        async with client("silence", 6, timeout_s=0.02) as sdo:
            with pytest.raises(SdoTimeoutError, match=r"within 20 ms, reading 0x2001:0"):
                await sdo.read(0x2001, 0)
        async with client("silence", 5) as sdo:
            # An answer to something never asked must not be taken for the answer.
            reading = asyncio.create_task(sdo.read(0x2004, 0))
            await asyncio.sleep(0)
            sdo.receive(b"\x4f\x01\x20\x00\x77\x00\x00\x00")
            sdo.receive(b"\x80\x01\x20\x00\x00\x00\x02\x06")
            sdo.receive(b"\x60\x04\x20\x00")
            assert await reading == b"\x11\x22\x33\x44"

    with local_nodes("silence", {5: served()}):
        asyncio.run(work())


def test_transfers_to_one_node_take_turns() -> None:
    async def work() -> None:
        async with client("turns", 5) as sdo:
            await sdo.write(0x2000, 0, b"a longer text than one frame")
            results = await asyncio.gather(*(sdo.read(0x2000, 0) for _ in range(8)))
            assert set(results) == {b"a longer text than one frame"}

    with local_nodes("turns", {5: served()}):
        asyncio.run(work())


def test_a_server_that_sends_more_than_it_announced_is_cut_short() -> None:
    async def work() -> list[bytes]:
        sent: list[bytes] = []
        sdo = SdoClient(sent.append, 1.0)
        reading = asyncio.create_task(sdo.read(0x1008, 0))
        await asyncio.sleep(0)
        sdo.receive(b"\x41\x08\x10\x00\x05\x00\x00\x00")
        await asyncio.sleep(0)
        sdo.receive(b"\x00abcdefg")
        with pytest.raises(SdoError, match="announced 5 bytes and sent 7"):
            await reading
        return sent

    assert asyncio.run(work())[-1] == b"\x80\x08\x10\x00\x10\x00\x07\x06"


def bring_up(config: Config, leave_out: int = 0) -> tuple[list[str], dict[int, Any]]:
    """Progress lines, and for each node what it holds afterwards."""
    progress: list[str] = []
    nodes: dict[int, Any] = {}

    async def work() -> None:
        fieldbus = CanopenFieldbus(config, ProcessImage(8))
        await fieldbus.start(progress.append)
        assert await fieldbus.sdo_read(0, 0x1008, 0) == b"EPOS4"
        await fieldbus.stop()

    with ExitStack() as networks:
        for channel in config.fieldbus.channels:
            ods = {drive.node_id: epos4(drive.node_id) for drive in channel.drives}
            ods |= {cell.node_id: force_cell(cell.node_id) for cell in channel.force_cells}
            ods.pop(leave_out, None)
            made = networks.enter_context(local_nodes(channel.name, ods))
            nodes |= dict(zip(ods, made, strict=True))
        with asyncio.Runner(loop_factory=RealTimeLoop) as runner:
            runner.run(work())
    return progress, nodes


def test_seventeen_independent_nodes_are_brought_to_operation() -> None:
    progress, nodes = bring_up(robot_on("ours"))
    assert progress[-1] == "17 nodes on 4 channels are operational"
    for node_id in range(1, 9):
        sdo = nodes[node_id].sdo
        assert sdo[0x6060].raw == 10
        assert sdo[0x1A00][3].raw == 0x60770010
        assert sdo[0x1400][1].raw == 0x200 + node_id
    assert nodes[25].sdo[0x6132][1].raw == 2


def test_the_one_that_is_missing_is_named() -> None:
    config = robot_on("missing")
    master = config.fieldbus.master.model_copy(update={"boot_timeout_ms": 600})
    fieldbus = config.fieldbus.model_copy(update={"master": master})
    config = config.model_copy(update={"fieldbus": fieldbus})
    with pytest.raises(BringUpError, match=r"^1 of 17 .*missing3/25 \(load cell 8\): missing"):
        bring_up(config, leave_out=25)
