"""The relay in the circuit of the STO inputs: its node, its contacts and the drives in the lab, and
what the daemon makes of it. STO-4 and STO-5."""

from __future__ import annotations

import asyncio
import struct

import can
import pytest

from tests.relay_bench import PATH, SUPERVISOR, Bench, Segment, played
from tonus.config import load
from tonus.config.schema.faults import Loss
from tonus.config.schema.lab import LabScript
from tonus.config.schema.sto_relay import StoRelay
from tonus.config.timeouts import node_timeout_ms
from tonus.drivers.canopen.node import Node
from tonus.drivers.canopen.sto_relay import RelayedFieldbus
from tonus.drivers.errors import BringUpError, DriverError
from tonus.drivers.process_image import AxisCommand, AxisState, ProcessImage
from tonus.runtime.timing import clock
from tonus.sim.devices.output_node import OutputNode
from tonus.sim.errors import LabError
from tonus.sim.lab.engine import Lab
from tonus.tools.run import fieldbuses

MS = 1_000_000
STO = 0x8A88
HEARTBEAT = 0x778
"""of the relay's node"""


# --- in the lab ----------------------------------------------------------------------------------


@played()
async def test_without_its_output_no_drive_can_be_enabled(bench: Bench) -> None:
    assert not bench.closed
    assert bench.torque_off == [True] * 8
    drive = bench.lab.drives[0]
    assert not drive.may_enable()
    assert drive.objects.number(0x603F, 0) == STO


@played(**{"sto_relay.timeout_ms": 100})
async def test_contacts_follow_the_output_and_the_torque_the_contacts(bench: Bench) -> None:
    await bench.held()
    assert bench.torque_off == [False] * 8
    bench.holds = False
    bench.send(0x200 + bench.relay.node_id, b"\0")
    await asyncio.sleep(0.011)
    assert bench.closed
    await asyncio.sleep(0.002)
    assert not bench.closed
    assert bench.torque_off == [False] * 8
    await asyncio.sleep(0.023)
    assert bench.torque_off == [False] * 8
    await asyncio.sleep(0.002)
    assert bench.torque_off == [True] * 8
    bench.send(0x200 + bench.relay.node_id, b"\1")
    await asyncio.sleep(0.014)
    assert not bench.closed
    await asyncio.sleep(0.002)
    assert bench.closed
    assert bench.torque_off == [False] * 8


@played(**{"sto_relay.timeout_ms": 100})
async def test_the_last_change_of_the_output_counts(bench: Bench) -> None:
    await bench.held()
    for data in (b"\0", b"\1"):
        bench.send(0x200 + bench.relay.node_id, data)
        await asyncio.sleep(0.008)
    for _ in range(60):
        assert bench.closed
        assert bench.torque_off == [False] * 8
        await asyncio.sleep(0.001)


@played()
async def test_the_output_ends_with_the_heartbeat_and_stays_off(bench: Bench) -> None:
    """Though frames go on that would set it."""
    await bench.held()
    bench.beats = False
    bench.segment.image.commands["command"] = AxisCommand.ENABLE
    await bench.pass_ms(9)
    assert bench.node.outputs == 0
    await bench.pass_ms(200)
    assert bench.node.outputs == 0
    assert not bench.closed
    assert bench.torque_off == [True] * 8


@played()
async def test_the_fault_of_the_sto_inputs_and_the_relay_are_two_causes(bench: Bench) -> None:
    drive = bench.lab.drives[2]
    await bench.held()
    drive.set_input("sto", True)
    assert bench.torque_off[2]
    bench.holds = bench.beats = False
    await bench.pass_ms(60)
    drive.set_input("sto", False)
    assert bench.torque_off == [True] * 8


def test_outputs_without_an_error_mode_stay_and_others_take_their_value() -> None:
    seen: list[int] = []
    node = OutputNode(5, seen.append)
    put = node.writer(0x6200, 1)
    node.set_operational(True)
    for mode, value, after in ((0xFF, 0x00, 0x00), (0x0F, 0x05, 0xA5), (0x00, 0x00, 0xAA)):
        node.objects.find(0x6206, 1).value = mode
        node.objects.find(0x6207, 1).value = value
        put(0xAA)
        node.fail(0x8130)
        assert node.outputs == seen[-1] == after
        put(0xAA)
        node.set_operational(False)
        assert node.outputs == after
    assert node.objects.number(0x1001, 0) == 0x10
    node.communication_reset()
    assert node.objects.number(0x1001, 0) == 0
    node.power_cycle()
    assert node.outputs == 0


def test_a_relay_on_a_channel_of_the_fieldbus_is_refused() -> None:
    relay = load(PATH)[0].sto_relay
    assert relay is not None
    stated = {"sto_relay": relay.model_dump(mode="json") | {"channel": "can1"}}
    config, _ = load("config/mixed.yaml", overrides=stated)
    with pytest.raises(LabError, match=r"sto_relay\.channel: can1"):
        Lab(config, LabScript(), seed=1, clock=lambda: 0)
    stated = {"sto_relay": relay.model_dump(mode="json") | {"bitrate": 500_000}}
    config, _ = load("config/mixed.yaml", overrides=stated)
    with pytest.raises(LabError, match=r"sto_relay\.bitrate: .* 1000000, not 500000"):
        Lab(config, LabScript(), seed=1, clock=lambda: 0)


def test_a_relay_that_is_not_emulated_has_no_wires_in_the_lab() -> None:
    config, _ = load(PATH)
    lab = Lab(config, LabScript(), seed=1, clock=lambda: 0, nodes=frozenset())
    assert lab.channels == {}
    assert lab.drives[0].may_enable()


# --- the daemon's side ---------------------------------------------------------------------------


@played()
async def test_the_node_is_told_what_ends_its_output(bench: Bench) -> None:
    await bench.start()
    assert bench.object(0x1016, 1) == SUPERVISOR << 16 | 7
    assert bench.object(0x6206, 1) == 0xFF
    assert bench.object(0x6207, 1) == 0
    assert bench.object(0x1400, 2) == bench.object(0x1800, 2) == 255
    assert bench.object(0x1017, 0) == bench.relay.heartbeat_ms
    assert bench.segment.done == ["start"]


@played(**{"supervisor.policy": "use"})
async def test_arming_waits_for_closed_contacts_whatever_the_policy(bench: Bench) -> None:
    await bench.start()
    await bench.pass_ms(20)
    assert bench.obstacles == {"sto relay": "is open: the supervisor does not hold it"}
    bench.beats = bench.holds = True
    await bench.pass_ms(40)
    assert bench.obstacles == {}
    assert bench.names() == []


@played(**{"supervisor.policy": "require"})
async def test_where_it_is_required_the_supervisor_has_to_be_heard(bench: Bench) -> None:
    await bench.start()
    await bench.pass_ms(20)
    assert bench.obstacles["supervisor of sto"] == "is not heard on sto"
    bench.beats = bench.holds = True
    await bench.pass_ms(40)
    assert bench.obstacles == {}


@played()
async def test_a_relay_that_opens_under_enabled_drives_is_an_event(bench: Bench) -> None:
    await bench.held()
    bench.segment.image.commands["command"] = AxisCommand.ENABLE
    await bench.pass_ms(10)
    assert bench.names() == []
    bench.beats = False
    await bench.pass_ms(100)
    assert bench.names() == ["emcy", "sto_relay_open", "supervisor_lost"]
    assert "sto relay" in bench.obstacles
    bench.segment.image.commands["command"] = AxisCommand.DISABLE
    bench.beats = True
    await bench.pass_ms(200)
    assert bench.closed, "started again, while no drive is to be enabled"
    assert bench.obstacles == {}


def _say(bench: Bench, state: AxisState) -> None:
    """What the drives answer, in each tick anew."""
    axes = bench.segment.image.axes
    axes["state"], axes["age"] = state, 0


@played()
async def test_a_relay_that_stays_closed_without_the_supervisor(bench: Bench) -> None:
    """By whatever it is: the drives say so, and whoever heeds it once has obeyed."""
    await bench.held()
    relay, image = bench.relay, bench.segment.image
    image.commands["command"] = AxisCommand.ENABLE
    _say(bench, AxisState.OPERATION_ENABLED)
    await bench.pass_ms(20)
    bench.beats = bench.holds = False
    opened_ms = relay.timeout_ms + relay.release_ms + 2 * relay.heartbeat_ms
    limit = round(opened_ms + relay.torque_off_ms)
    waited = 0
    while not image.supervisor_ignored:
        await bench.pass_ms(1)
        waited += 1
    assert limit - 2 <= waited <= limit + 2
    _say(bench, AxisState.FAULT)
    await bench.pass_ms(1)
    assert not image.supervisor_ignored
    _say(bench, AxisState.OPERATION_ENABLED)
    await bench.pass_ms(limit + 2)
    assert not image.supervisor_ignored
    bench.beats = bench.holds = True
    await bench.pass_ms(5)
    bench.beats = False
    await bench.pass_ms(limit + 2)
    assert image.supervisor_ignored, "lost again"
    await bench.fieldbus.stop()
    assert not image.supervisor_ignored


@played()
async def test_a_relay_whose_node_is_silent(bench: Bench) -> None:
    await bench.held()
    bench.lab.unplug(bench.relay.channel, bench.relay.node_id)
    assert not bench.segment.image.unguarded
    await bench.pass_ms(200)
    assert bench.segment.image.unguarded
    assert "does not answer" in bench.obstacles["sto relay"]
    assert "heartbeat_lost" in bench.names()
    bench.lab.replug(bench.relay.channel, bench.relay.node_id)
    await bench.pass_ms(300)
    assert "heartbeat_back" in bench.names()
    assert not bench.segment.image.unguarded
    # Unplugged it lost the supervisor, and is not operational; but it may have restarted as well.
    assert bench.obstacles["sto relay"] == "restarted and lost its configuration; reset"
    bench.holds = bench.beats = False
    task = asyncio.get_running_loop().create_task(bench.fieldbus.recover())
    while not task.done():
        await bench.pass_ms(1)
    bench.holds = bench.beats = True
    await bench.pass_ms(60)
    assert bench.obstacles == {}


@played(**{"supervisor.policy": "use", "tolerance.jitter_ms": 20})
async def test_when_a_relay_counts_as_silent(bench: Bench) -> None:
    """After 40 ms: with one lost heartbeat of 10 ms, and 20 ms of jitter; no longer than the bus is
    up."""
    await bench.held()
    limit = node_timeout_ms(bench.relay, bench.relay.master, bench.config.tolerance)
    assert limit == 40
    bench.lab.inject(Loss(channel=bench.relay.channel, identifier=HEARTBEAT, frames=1))
    await bench.pass_ms(30)
    assert not bench.segment.image.unguarded
    bench.lab.inject(Loss(channel=bench.relay.channel, identifier=HEARTBEAT, frames=1000))
    silent = 0
    while not bench.segment.image.unguarded:
        await bench.pass_ms(1)
        silent += 1
    assert limit - bench.relay.heartbeat_ms < silent <= limit + 2
    assert bench.closed, "it hangs: its output is still on"
    await bench.fieldbus.stop()
    assert not bench.segment.image.unguarded


@played()
async def test_a_relay_that_another_master_may_have_written_to(bench: Bench) -> None:
    """The supervisor has told so: not armed before a reset has brought it up from all its objects
    on, its watch too."""
    await bench.held()
    watch = bench.object(0x1016, 1)
    bench.node.objects.find(0x1016, 1).set(0)
    bench.beats = bench.holds = False
    bench.send(0x080 + SUPERVISOR, struct.pack("<HBBf", 0xFF1B, 0x81, 0xFF, 0x1016))
    await bench.pass_ms(2)
    told = [text for text in bench.obstacles.values() if "another master" in text]
    assert len(told) == 1
    bench.beats = bench.holds = True
    await bench.pass_ms(300)
    assert told[0] in bench.obstacles.values(), "that the heartbeat is back says nothing"
    bench.beats = bench.holds = False
    task = asyncio.get_running_loop().create_task(bench.fieldbus.recover())
    while not task.done():
        await bench.pass_ms(1)
    bench.beats = bench.holds = True
    await bench.pass_ms(300)
    assert bench.obstacles == {}
    assert bench.object(0x1016, 1) == watch


@played()
async def test_a_relay_that_restarted_waits_for_a_reset(bench: Bench) -> None:
    """Its watch is gone with its configuration: its output must not be set by anybody."""
    await bench.held()
    bench.lab.nodes[bench.relay.channel, bench.relay.node_id].power_cycle()
    await bench.pass_ms(300)
    assert "boot_up" in bench.names()
    assert bench.obstacles["sto relay"] == "restarted and lost its configuration; reset"
    assert not bench.closed
    task = asyncio.get_running_loop().create_task(bench.fieldbus.recover())
    while not task.done():
        bench.holds = bench.beats = False
        await bench.pass_ms(1)
    await task
    assert "recovered" in bench.names() + [each.name for each in bench.fieldbus.take_events()]
    assert bench.segment.done[-1] == "recover" or "recover" in bench.segment.done
    bench.holds = bench.beats = True
    await bench.pass_ms(60)
    assert bench.closed
    assert bench.obstacles == {}


@played()
async def test_a_relay_that_restarted_unnoticed_is_not_started(bench: Bench) -> None:
    """What it has stored is its configuration but for the watch, and its boot-up is lost. Until
    2026-11-29 it was taken for one that its watch had stopped: the output outlived the supervisor,
    and 683 N with it."""
    await bench.held()
    bench.holds = bench.beats = False
    await bench.pass_ms(30)
    bench.holds = bench.beats = True
    await bench.pass_ms(60)
    assert bench.closed, "its watch had stopped it, and it was started"
    watch = bench.node.objects.find(0x1016, 1)
    kept, watch.value = watch.value, 0
    bench.node.objects.save()
    watch.value = kept
    bench.lab.inject(Loss(channel=bench.relay.channel, identifier=HEARTBEAT, frames=1))
    bench.lab.nodes[bench.relay.channel, bench.relay.node_id].power_cycle()
    await bench.pass_ms(300)
    assert bench.object(0x1016, 1) == 0
    assert bench.obstacles["sto relay"] == "restarted and lost its configuration; reset"
    assert not bench.closed
    bench.holds = bench.beats = False
    await bench.pass_ms(60)
    assert "sto_relay_stuck" not in bench.names()


@played()
async def test_each_reset_brings_the_relay_up_anew(bench: Bench) -> None:
    """Who has written to it in FAULT nobody has seen."""
    await bench.held()
    watch = bench.object(0x1016, 1)
    bench.node.objects.find(0x1016, 1).set(0)
    bench.beats = bench.holds = False
    assert bench.obstacles == {}, "nothing was found"
    task = asyncio.get_running_loop().create_task(bench.fieldbus.recover())
    while not task.done():
        await bench.pass_ms(1)
    assert bench.object(0x1016, 1) == watch


@played()
async def test_a_relay_that_restarts_while_it_is_brought_up_is_not_used(bench: Bench) -> None:
    """It has forgotten its watch, and would be started without one."""
    await bench.held()
    bench.beats = bench.holds = False
    start = Node.start

    async def booted(node: Node) -> None:
        node.monitor.receive(b"\0")
        await start(node)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Node, "start", booted)
        task = asyncio.get_running_loop().create_task(bench.fieldbus.recover())
        while not task.done():
            await bench.pass_ms(1)
    await bench.pass_ms(300)
    assert bench.obstacles["sto relay"] == "restarted and lost its configuration; reset"


def welded(bench: Bench) -> None:
    """The mirror contact never closes."""
    node = bench.node
    reader = node.objects.find(0x6000, 1)
    reader.read = lambda: 0


@played()
async def test_a_welded_relay_is_not_brought_up(bench: Bench) -> None:
    welded(bench)
    with pytest.raises(BringUpError, match=r"sto/120 .*a contact is welded"):
        await bench.start()
    assert bench.segment.done == []


@played()
async def test_a_relay_that_is_welded_later_is_seen_when_nobody_holds_it(bench: Bench) -> None:
    await bench.held()
    welded(bench)
    bench.beats = bench.holds = False
    await bench.pass_ms(300)
    assert bench.obstacles["sto relay"] == (
        "is closed although its output is off: a contact is welded"
    )
    assert "sto_relay_stuck" in bench.names()


@played()
async def test_contacts_that_were_not_seen_open_are_in_doubt(bench: Bench) -> None:
    """The supervisor was silent and is back; only a reset, in which they are seen open, tells that
    they still open. A supervisor that goes on has nothing to be seen by."""
    await bench.held()
    read = bench.node.objects.find(0x6000, 1).read
    welded(bench)
    await bench.pass_ms(40)
    assert bench.obstacles == {}
    bench.beats = bench.holds = False
    assert bench.config.supervisor is not None
    await bench.pass_ms(bench.config.supervisor.timeout_ms + 5)
    bench.beats = bench.holds = True
    await bench.pass_ms(200)
    assert bench.obstacles["sto relay"] == (
        "was not seen to open while the supervisor was silent; reset"
    )
    bench.node.objects.find(0x6000, 1).read = read
    bench.beats = bench.holds = False
    task = asyncio.get_running_loop().create_task(bench.fieldbus.recover())
    while not task.done():
        await bench.pass_ms(1)
    bench.beats = bench.holds = True
    await bench.pass_ms(200)
    assert bench.obstacles == {}


@played()
async def test_contacts_that_were_seen_open_are_in_order(bench: Bench) -> None:
    await bench.held()
    for _ in range(2):
        bench.beats = bench.holds = False
        await bench.pass_ms(200)
        assert "sto relay" in bench.obstacles
        bench.beats = bench.holds = True
        await bench.pass_ms(200)
        assert bench.obstacles == {}


@played(**{"supervisor.quiet_s": 0.3})
async def test_a_stranger_that_holds_the_relay_is_refused(bench: Bench) -> None:
    """It sends the supervisor's heartbeat while there is no record that one could judge."""
    stranger = asyncio.get_running_loop().create_task(beat(bench))
    with pytest.raises(BringUpError, match=r"another device on sto sends heartbeats"):
        await bench.start()
    stranger.cancel()
    assert bench.segment.done == []


async def beat(bench: Bench) -> None:
    while True:
        bench.send(0x700 + SUPERVISOR, b"\5")
        await asyncio.sleep(0.006)


@played()
async def test_a_recovery_that_fails_is_an_event(bench: Bench) -> None:
    await bench.held()
    bench.lab.nodes[bench.relay.channel, bench.relay.node_id].power_cycle()
    await bench.pass_ms(20)
    welded(bench)
    task = asyncio.get_running_loop().create_task(bench.fieldbus.recover())
    while not task.done():
        await bench.pass_ms(1)
    await bench.pass_ms(1)
    assert "recovery_failed" in bench.names()


@played()
async def test_the_relay_opens_when_the_segment_cannot_be_started(bench: Bench) -> None:
    bench.segment.fails = True
    with pytest.raises(DriverError, match="no slaves"):
        await bench.start()
    assert bench.node.outputs == 0


@played()
async def test_what_is_the_segments_own_goes_to_it(bench: Bench) -> None:
    assert await bench.fieldbus.sdo_read(3, 0x6041, 1) == b"\3\1"
    await bench.fieldbus.sdo_write(3, 0x6041, 1, b"\7")
    assert bench.segment.done == ["write 3 6041:1 07"]
    assert bench.fieldbus.channels == ("none",)
    await bench.start()
    await bench.pass_ms(1)
    assert bench.segment.done[1:] == ["start", "collect 0", "publish 0"]
    assert [event.where for event in bench.events] == ["none"]


def test_a_channel_that_cannot_be_opened() -> None:
    config, _ = load(PATH)

    def gone(_: StoRelay) -> can.BusABC:
        raise OSError("no such device")

    fieldbus = RelayedFieldbus(config, Segment(), open_bus=gone, clock=lambda: 0)
    with pytest.raises(BringUpError, match="sto cannot be opened on interface tonus: no such dev"):
        clock.run(fieldbus.start(lambda _: None), virtual=True)


def test_without_a_relay_there_is_nothing_beside_the_segment() -> None:
    config, _ = load(PATH, overrides={"sto_relay": None})
    with pytest.raises(DriverError, match="no relay"):
        RelayedFieldbus(config, Segment())
    lab = Lab(config, LabScript(), seed=1, clock=lambda: 0)

    async def built() -> object:
        return fieldbuses.build(config, ProcessImage(8), lab)

    assert not isinstance(clock.run(built(), virtual=True), RelayedFieldbus)
