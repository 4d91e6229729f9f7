"""Every fault a lab can be asked for, seen from the bus; what it refuses; how faults end."""

from __future__ import annotations

import json
import struct
from typing import Any

import can
import pytest
from lab_bench import Bench

from tonus.config.schema.faults import FAULT
from tonus.config.schema.lab import LabScript
from tonus.sim.devices.cia402.states import State
from tonus.sim.errors import LabError


def inject(bench: Bench, kind: str, channel: str | None = "can0", **fields: Any) -> None:
    where = {} if channel is None else {"channel": channel}
    bench.lab.inject(FAULT.validate_python({"kind": kind, **where, **fields}))


def frames(messages: list[can.Message], identifier: int) -> list[can.Message]:
    return [m for m in messages if m.arbitration_id == identifier and not m.is_error_frame]


def emergencies(messages: list[can.Message], node: int) -> list[int]:
    return [struct.unpack_from("<H", m.data)[0] for m in frames(messages, 0x80 + node) if m.dlc]


def bus_error(message: can.Message) -> bool:
    """Whether it reports an error, and not only a change of state."""
    return bool(message.arbitration_id & 0x080)


def running(bench: Bench) -> Bench:
    bench.configure_all()
    bench.enable()
    for name in bench.buses:
        bench.read(name)
    return bench


def ticks(bench: Bench, count: int, channel: str = "can0") -> list[can.Message]:
    """What came on a channel in so many ticks."""
    for _ in range(count):
        try:
            bench.tick(0x0F, 30)
        except can.CanOperationError:
            bench.wait(1)
    return bench.read(channel)


def test_lost_frames_are_missing_and_nothing_else_is() -> None:
    with running(Bench()) as bench:
        inject(bench, "loss", identifier=0x181, frames=3)
        seen = ticks(bench, 10)
        assert [len(frames(seen, node)) for node in (0x181, 0x187, 0x191)] == [7, 10, 10]
        assert not bench.lab.faults(), "it is spent"
        assert bench.lab.statistics()["channels"]["can0"]["error_frames"] == 0


def test_corrupted_frames_come_late_and_are_counted() -> None:
    with running(Bench()) as bench:
        inject(bench, "corruption", probability=0.1)
        seen = ticks(bench, 100)
        assert [len(frames(seen, node)) for node in (0x181, 0x187, 0x191)] == [100] * 3
        channel = bench.lab.statistics()["channels"]["can0"]
        assert 40 < channel["error_frames"] < 160
        assert channel["error_frames"] == len(
            [m for m in seen if m.is_error_frame and bus_error(m)]
        )
        assert channel["retransmissions"] == channel["error_frames"]


def test_a_drive_whose_every_frame_is_corrupted_goes_off_and_says_so_when_it_is_back() -> None:
    with running(Bench()) as bench:
        inject(bench, "corruption", identifier=0x181, duration=0.008)
        seen = ticks(bench, 30)
        assert emergencies(seen, 1) == [0x8120, 0x81FD]
        assert bench.lab.drives[0].state in (State.FAULT_REACTION_ACTIVE, State.FAULT)
        assert bench.lab.drives[6].enabled
        assert frames(seen, 0x181), "it is back"


def test_a_delayed_frame_is_late_by_its_delay() -> None:
    with running(Bench()) as bench:
        before = frames(ticks(bench, 1), 0x191)[0].timestamp % 1e-3
        inject(bench, "delay", identifier=0x191, delay_us=700, frames=1)
        late, on_time = frames(ticks(bench, 2), 0x191)
        # It enters the queue 700 us after SYNC (48 us) and response (10 us), and the bus is idle.
        assert late.timestamp % 1e-3 == pytest.approx((48 + 10 + 700 + 80) * 1e-6, abs=8e-6)
        assert on_time.timestamp % 1e-3 == pytest.approx(before, abs=30e-6)


def test_a_duplicate_comes_twice() -> None:
    with running(Bench()) as bench:
        inject(bench, "duplicate", identifier=0x187)
        seen = ticks(bench, 5)
        assert len(frames(seen, 0x187)) == 10
        assert len(frames(seen, 0x181)) == 5


def test_a_babbling_controller_starves_all_others() -> None:
    with running(Bench()) as bench:
        inject(bench, "babble", identifier=0x001, duration=0.05)
        seen = ticks(bench, 45)
        assert len(frames(seen, 0x001)) > 350
        assert len(frames(seen, 0x181)) <= 1
        seen = ticks(bench, 60)
        assert not frames(seen[-100:], 0x001)
        assert len(frames(seen, 0x191)) > 40, "the bus is free again"
        assert ticks(bench, 5, "can1"), "another channel felt nothing"


def test_a_drive_that_cannot_say_what_every_sync_asks_of_it_has_a_queue_overflow() -> None:
    with running(Bench()) as bench:
        inject(bench, "babble", identifier=0x100)
        depth = bench.config.lab.bus.queue_depth
        for _ in range(depth):
            bench.send("can0", 0x080)
            bench.wait(1)
        assert bench.lab.drives[0].enabled
        for _ in range(10):
            bench.send("can0", 0x080)
            bench.wait(1)
        assert not bench.lab.drives[0].enabled
        assert bench.lab.drives[0].objects.number(0x603F, 0) == 0x81FF
        controllers = bench.lab.statistics()["channels"]["can0"]["controllers"]
        assert controllers["node 1"]["overflows"] >= 10


def test_a_babbler_with_a_period_keeps_it() -> None:
    with running(Bench()) as bench:
        inject(bench, "babble", identifier=0x7FF, period_us=1000)
        stamps = [m.timestamp for m in frames(ticks(bench, 20), 0x7FF)]
        assert 19 <= len(stamps) <= 20
        assert stamps[-1] - stamps[0] == pytest.approx((len(stamps) - 1) * 1e-3, abs=500e-6)


def test_a_bus_held_dominant_makes_everybody_passive() -> None:
    with running(Bench()) as bench:
        inject(bench, "stuck", duration=0.02)
        seen = ticks(bench, 15)
        assert not frames(seen, 0x181)
        assert bench.buses["can0"].state is can.BusState.PASSIVE
        assert bench.buses["can1"].state is can.BusState.ACTIVE
        for _ in range(bench.config.lab.bus.queue_depth - _queued(bench)):
            bench.send("can0", 0x80)
        with pytest.raises(can.CanOperationError, match="full"):
            bench.send("can0", 0x80)
        seen = ticks(bench, 60)
        assert emergencies(seen, 1)[0] == 0x8120
        assert bench.buses["can0"].state is can.BusState.ACTIVE, "it has recovered"


def test_touching_wires_take_senders_to_bus_off() -> None:
    with running(Bench()) as bench:
        inject(bench, "stuck", level="recessive")
        bench.tick(0x0F)
        assert bench.buses["can0"].state is can.BusState.ERROR
        inject(bench, "clear")
        assert not bench.lab.faults()
        ticks(bench, 5)
        assert bench.buses["can0"].state is can.BusState.ACTIVE


def test_a_disconnected_daemon_is_alone_and_the_devices_go_on() -> None:
    with running(Bench()) as bench:
        before = bench.lab.statistics()["channels"]["can0"]["frames"]
        inject(bench, "disconnect")
        seen = ticks(bench, 30)
        assert not [m for m in seen if not m.is_error_frame]
        assert bench.buses["can0"].state is can.BusState.PASSIVE
        channel = bench.lab.statistics()["channels"]["can0"]
        assert not channel["controllers"][_host(channel)]["connected"]
        assert channel["frames"] - before < 5, "without SYNC there is little to say"
        inject(bench, "clear", channel=None)
        seen = ticks(bench, 10)
        assert len(frames(seen, 0x191)) >= 8
        assert bench.buses["can0"].state is can.BusState.ACTIVE


def _queued(bench: Bench) -> int:
    channel = bench.lab.statistics()["channels"]["can0"]
    return int(channel["controllers"][_host(channel)]["queued"])


def _host(channel: Any) -> str:
    (name,) = (name for name in channel["controllers"] if name.startswith("host"))
    return str(name)


def test_a_pulled_drive_is_alone_and_knows_it_soon() -> None:
    with running(Bench()) as bench:
        assert bench.write("can0", 1, 0x1017, 0, 10, 2) == 0
        inject(bench, "unplug", node=1)
        seen = ticks(bench, 40)
        assert not frames(seen, 0x181)
        assert bench.lab.drives[0].state in (State.FAULT_REACTION_ACTIVE, State.FAULT)
        assert bench.lab.faults()[0]["fault"] == {"kind": "unplug", "channel": "can0", "node": 1}
        inject(bench, "replug", node=1)
        assert not bench.lab.faults()
        seen = ticks(bench, 20)
        assert 0x8120 in emergencies(seen, 1), "said when somebody listens"
        assert frames(seen, 0x701)


def test_a_broken_cell_is_mended_by_clearing() -> None:
    with running(Bench()) as bench:
        inject(bench, "cell_break", node=17)
        assert struct.unpack("<i", frames(ticks(bench, 3), 0x191)[-1].data) == (50000,)
        inject(bench, "clear")
        assert struct.unpack("<i", frames(ticks(bench, 3), 0x191)[-1].data) != (50000,)


def test_an_input_is_told_while_it_acts_and_released_by_clearing() -> None:
    with running(Bench()) as bench:
        drive = bench.lab.drives[0]
        for name in ("sto", "home", "sto"):
            inject(bench, "drive_input", node=1, input=name)
        assert [each["fault"]["input"] for each in bench.lab.faults()] == ["home", "sto"]
        inject(bench, "drive_input", node=1, input="home", active=False)
        assert [each["fault"]["input"] for each in bench.lab.faults()] == ["sto"]
        assert drive.objects.number(0x3202, 1) == 0
        inject(bench, "clear")
        assert drive.objects.number(0x3202, 1) == 3
        assert not bench.lab.faults()


def test_a_fault_with_a_time_waits_for_it() -> None:
    with running(Bench()) as bench:
        inject(bench, "drive_error", node=7, code=0x4210, at=0.01)
        assert not emergencies(ticks(bench, 9), 7)
        assert emergencies(ticks(bench, 3), 7) == [0x4210]


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"kind": "loss", "channel": "can9"}, "no channel 'can9'; there are can0, can1"),
        (
            {"kind": "unplug", "channel": "can0", "node": 3},
            "no node 3 on channel 'can0'; there are 1",
        ),
        ({"kind": "drive_error", "channel": "can0", "node": 17, "code": 0x1000}, "not a drive"),
        ({"kind": "drive_error", "channel": "can0", "node": 1, "code": 0x1234}, "no error 0x1234"),
        ({"kind": "cell_break", "channel": "can0", "node": 1}, "not a load cell"),
        ({"kind": "drive_input", "channel": "can0", "node": 17, "input": "sto"}, "not a drive"),
        ({"kind": "clear", "channel": "x"}, "no channel 'x'"),
    ],
)
def test_what_a_lab_does_not_have_is_refused_in_one_line(fault: Any, words: str) -> None:
    with Bench() as bench, pytest.raises(LabError, match=words) as refused:
        bench.lab.inject(FAULT.validate_python(fault))
    assert "\n" not in str(refused.value)


def test_a_lab_without_can_says_so() -> None:
    with Bench("config/direct.yaml") as bench, pytest.raises(LabError, match="there is none"):
        inject(bench, "loss")


def _disturbed(seed: int, step_us: int) -> bytes:
    """All that is heard of a run with every fault of frames at work on two channels."""
    faults = tuple(
        FAULT.validate_python({"at": 0.01, "channel": channel, "duration": 0.03, **fields})
        for channel in ("can0", "can2")
        for fields in (
            {"kind": "corruption", "probability": 0.2},
            {"kind": "loss", "probability": 0.1},
            {"kind": "delay", "probability": 0.1, "delay_us": 300},
            {"kind": "duplicate", "probability": 0.1},
            {"kind": "babble", "identifier": 0x100, "period_us": 500},
        )
    )
    with Bench(script=LabScript(faults=faults), seed=seed) as bench:
        bench.configure_all()
        bench.enable()
        out = bytearray()
        for _ in range(60):
            for spec in bench.config.fieldbus.channels:
                bench.send(spec.name, 0x080)
            for _ in range(1000 // step_us):
                bench.wait(step_us * 1e-3)
            for name in bench.buses:
                for m in bench.read(name):
                    out += struct.pack("<dI", m.timestamp, m.arbitration_id) + m.data
        return bytes(out)


def test_equal_seeds_disturb_equally_however_time_is_stepped() -> None:
    first = _disturbed(1, 1000)
    assert first == _disturbed(1, 50)
    assert first != _disturbed(2, 1000)


def test_statistics_are_plain_and_count_what_was_sent() -> None:
    with running(Bench()) as bench:
        bench.lab.measure_latency()
        start = bench.lab.channels["can0"].frames
        ticks(bench, 1100)
        found = bench.lab.statistics()
        assert json.loads(json.dumps(found)) == found
        channel = found["channels"]["can0"]
        assert channel["frames"] - start == 1100 * 8
        assert set(channel["latency"]) == {"0x080", "0x181", "0x187", "0x191", "0x197"} | {
            "0x201",
            "0x207",
            "0x77F",
        }
        sync = channel["latency"]["0x080"]
        assert sync["count"] == 1100
        assert sync["mean_us"] == sync["p99_us"] == sync["max_us"] == 48.0
        assert channel["latency"]["0x77F"]["mean_us"] > 300, "it waits behind eight others"
        assert channel["load_1s"] == pytest.approx(0.66, abs=0.03)
        assert set(channel["controllers"]) == {"node 1", "node 7", "node 17", "node 23", "host 4"}
