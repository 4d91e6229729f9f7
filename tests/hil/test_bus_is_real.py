"""The bus is real: what a listener sees on it, and what happens when a node or the master goes."""

from __future__ import annotations

import can
import numpy as np
import pytest
from loop import QUICK

import tonus
from tonus.config import load
from tonus.config.schema.bus import CanopenBus
from tonus.config.timeouts import master_timeout_ms
from tonus.drivers.canopen.master import CanopenFieldbus
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.states import State
from tonus.runtime.timing import clock
from tonus.sim.lab.engine import Lab
from tonus.tools.testing.held import HeldFactory
from tonus.tools.testing.player import Player

DRIVES, CELLS = (1, 7), (17, 23)


def test_a_plain_listener_sees_the_documented_frames() -> None:
    """Boot-up, SDO configuration, SYNC, RPDO and TPDO with their COB-IDs, by python-can alone."""
    config, scenario = load("config/can.yaml", "hold", QUICK)

    async def listen() -> list[can.Message]:
        lab = Lab(config, scenario.lab, seed=1, clock=clock.now_ns)
        lab.open()
        listener = can.Bus(interface="tonus", channel="can0")
        master = CanopenFieldbus(config, ProcessImage(8))
        await master.start(lambda _: None)
        for tick in range(20):
            master.collect(tick)
            master.publish(tick)
            await _milliseconds(1)
        await master.stop()
        await _milliseconds(5)
        seen = []
        while (message := listener.recv(timeout=0)) is not None:
            seen.append(message)
        listener.shutdown()
        lab.close()
        return seen

    seen = clock.run(listen(), virtual=True)
    identifiers = {message.arbitration_id for message in seen}
    for node in (*DRIVES, *CELLS):
        boots = [m for m in seen if m.arbitration_id == 0x700 + node and m.data == b"\x00"]
        assert boots, f"no boot-up of node {node}"
        assert {0x600 + node, 0x580 + node, 0x180 + node} <= identifiers
    for node in DRIVES:
        assert 0x200 + node in identifiers
    syncs = [m.timestamp for m in seen if m.arbitration_id == 0x080 and m.dlc == 0]
    assert len(syncs) >= 20
    assert np.allclose(np.diff(syncs[:20]), 1e-3, atol=1e-9)
    assert all(m.dlc == 8 for m in seen if m.arbitration_id == 0x181)


@pytest.mark.tonus(overrides=QUICK)
@pytest.mark.tonus_expect("*")
def test_a_node_that_stops_answering_is_a_named_fault_and_a_controlled_stop(
    tonus_held: HeldFactory,
) -> None:
    fault = tonus.faults.Unplug(channel="can1", node=3, at=2.6)
    run = tonus_held.play(faults=[fault], duration=5.0)
    assert run.state == "FAULT"
    assert "can1/3" in run.reason
    assert "stopped answering" in run.reason
    run.expect("drive_lost", where="can1/3")
    assert len([event for event in run.events if event.name == "drive_lost"]) == 1
    states, drives = run.log["/tonus/state"]["state"], run.log["/tonus/drives"]
    assert {State.ACTIVE, State.SAFE_STOP} <= set(states)
    old = drives["age"][:, 2] > load("config/can.yaml")[0].control.freshness.measurement_ticks
    assert old.any()
    assert not drives["torque_command"][old, 2].any()


def test_when_the_master_falls_silent_every_drive_leaves_operation_enabled() -> None:
    """By its own heartbeat consumer, within the configured time, and with the right emergency."""
    config, scenario = load("config/can.yaml", "hold", QUICK)
    bus = config.fieldbus
    assert isinstance(bus, CanopenBus)
    timeout_ms = master_timeout_ms(bus, bus.drive, config.tolerance)

    async def go_silent() -> tuple[list[int], list[int], set[int]]:
        lab = Lab(config, scenario.lab, seed=1, clock=clock.now_ns)
        lab.open()
        image = ProcessImage(8)
        master = CanopenFieldbus(config, image)
        listener = can.Bus(interface="tonus", channel="can0")
        await master.start(lambda _: None)
        image.commands["command"] = 1
        for tick in range(40):
            master.collect(tick)
            master.publish(tick)
            await _milliseconds(1)
        enabled = [drive.statusword() & 0x6F for drive in lab.drives]
        await _milliseconds(timeout_ms + 5)
        lab.advance(clock.now_ns())
        after = [drive.statusword() & 0x6F for drive in lab.drives]
        codes = set()
        while (message := listener.recv(timeout=0)) is not None:
            if message.arbitration_id in (0x081, 0x087):
                codes.add(int.from_bytes(message.data[:2], "little"))
        listener.shutdown()
        lab.close()
        return enabled, after, codes

    enabled, after, codes = clock.run(go_silent(), virtual=True)
    assert enabled == [0x27] * 8
    assert 0x27 not in after
    assert 0x8130 in codes


@pytest.mark.tonus(config="config/one_channel.yaml", overrides=QUICK)
@pytest.mark.tonus_expect("*")
def test_one_channel_at_1_khz_visibly_overloads(tonus_run: Player) -> None:
    run = tonus_run("hold", duration=0.5)
    assert run.state == "FAULT"
    fresh = load("config/one_channel.yaml")[0].control.freshness.measurement_ticks
    assert (run.log["/tonus/drives"]["age"] > fresh).any()


async def _milliseconds(count: int) -> None:
    import asyncio

    await asyncio.sleep(count * 1e-3)


@pytest.mark.tonus(overrides=QUICK)
def test_the_log_holds_every_frame_of_a_channel(tonus_held: HeldFactory) -> None:
    """Per tick: one SYNC, an RPDO per drive, a TPDO per drive and cell."""
    held = tonus_held()
    held.advance(500)
    log = held.end().log
    channels = (
        ("can0", (1, 7), (1, 7, 17, 23)),
        ("can3", (2, 8), (2, 8, 18, 24, 25)),
    )
    for channel, drives, nodes in channels:
        identifiers = log[f"/can/{channel}"]["id"]
        wanted = [0x080, *(0x200 + node for node in drives), *(0x180 + node for node in nodes)]
        for identifier in wanted:
            assert abs(int((identifiers == identifier).sum()) - 500) <= 2
