"""Each fault of the segment is a named event with its slave and what is done about it, and no
torque goes out that rests on a measurement older than the freshness."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from segment_bench import PERIOD_NS, SYNC0_NS, SegmentBench, beside, run, until

from tonus.drivers.ethercat.deterministic import DeterministicMaster
from tonus.drivers.ethercat.frames import FIRST_DATAGRAM, Command
from tonus.drivers.events import EVENTS
from tonus.drivers.process_image import AxisState
from tonus.sim.ethercat.slaves.states import State

FRESH = 3
TORQUE = 0.3


async def _enabled(overrides: dict[str, Any] | None = None) -> SegmentBench:
    bench = SegmentBench(overrides)
    await bench.start()
    await bench.enable(TORQUE)
    assert (bench.image.axes["state"] == AxisState.OPERATION_ENABLED).all()
    return bench


def _no_stale_torque(bench: SegmentBench) -> None:
    """What the frame just published carries, against the ages it was computed from."""
    fieldbus = bench.fieldbus
    for axis, data in enumerate(fieldbus._outputs[:8]):
        torque = int.from_bytes(data[2:4], "little", signed=True)
        if bench.image.axes["age"][axis] > FRESH:
            assert torque == 0, f"axis {axis} at age {bench.image.axes['age'][axis]}"


async def _watched(bench: SegmentBench, ticks: int) -> None:
    for _ in range(ticks):
        await bench.run(1)
        _no_stale_torque(bench)


def _ends_with_its_reaction(bench: SegmentBench) -> None:
    for event in bench.events:
        assert event.text.endswith(EVENTS[event.name].reaction)


def _is_process_data(frame: bytes) -> bool:
    return frame[FIRST_DATAGRAM] == Command.LRW


def _one_drive_less(frame: bytes, answer: bytes | None) -> bytes | None:
    """By the working counter of the process data."""
    if answer is None or not _is_process_data(frame):
        return answer
    changed = bytearray(answer)
    size = changed[FIRST_DATAGRAM + 6] | (changed[FIRST_DATAGRAM + 7] & 7) << 8
    changed[FIRST_DATAGRAM + 10 + size] -= 3
    return bytes(changed)


@pytest.mark.parametrize(("lost", "stays"), [(1, True), (FRESH, True), (FRESH + 2, False)])
def test_lost_frames_age_the_measurements_and_the_freshness_bridges_them(
    lost: int, stays: bool
) -> None:
    async def main() -> None:
        bench = await _enabled()
        left = lost

        def drop(frame: bytes, answer: bytes | None) -> bytes | None:
            nonlocal left
            if left and _is_process_data(frame):
                left -= 1
                return None
            return answer

        bench.between = drop
        states, ages = [], []
        for _ in range(lost + 3):
            await bench.run(1)
            _no_stale_torque(bench)
            states.append(int(bench.image.axes["state"][0]))
            ages.append(int(bench.image.axes["age"][0]))
        assert max(ages) == lost
        assert (AxisState.LOST not in states) == stays
        assert bench.named("frame_lost")[0].where == "tonus0"
        assert bench.fieldbus.lost.count == lost
        _ends_with_its_reaction(bench)

    run(main)


@pytest.mark.parametrize(("ticks", "stays"), [(1, True), (FRESH, True), (FRESH + 2, False)])
def test_the_freshness_bridges_a_silence_of_slaves_too(ticks: int, stays: bool) -> None:
    """It ages their measurements, and is no state that a drive is in."""

    async def main() -> None:
        bench = await _enabled()
        bench.inject("cable_break", behind=4, duration=ticks * 1e-3)
        lost, ages = np.zeros(8, dtype=bool), []
        for _ in range(ticks + 10):
            await _watched(bench, 1)
            lost |= bench.image.axes["state"] == AxisState.LOST
            ages.append(bench.image.axes["age"].copy())
        assert {event.where for event in bench.named("slave_silent")} >= {"tonus0/5", "tonus0/8"}
        assert lost.tolist() == [False] * 4 + [not stays] * 4
        assert np.max(ages) == ticks
        assert (bench.image.axes["state"] == AxisState.OPERATION_ENABLED).all()

    run(main)


def test_a_wrong_working_counter_renews_nothing() -> None:
    async def main() -> None:
        bench = await _enabled()

        bench.between = _one_drive_less
        await _watched(bench, 5)
        assert (bench.image.axes["age"] == 4).all()
        assert "working counter 23, expected is 26" in bench.named("wrong_working_counter")[0].text

    run(main)


def test_an_answer_of_an_earlier_tick_is_known_by_its_clock_and_not_used() -> None:
    """Indices come again after a while: a stalled segment's old answer then looks like the one that
    is waited for."""

    async def main() -> None:
        bench = await _enabled()
        kept: list[bytes] = []

        def keep(frame: bytes, answer: bytes | None) -> bytes | None:
            if answer is not None and _is_process_data(frame):
                kept.append(answer)
            return answer

        bench.between = keep
        await bench.run(20)

        def stale(frame: bytes, answer: bytes | None) -> bytes | None:
            if not _is_process_data(frame):
                return answer
            old = bytearray(kept[0])
            index = frame[FIRST_DATAGRAM + 1]
            size = old[FIRST_DATAGRAM + 6] | (old[FIRST_DATAGRAM + 7] & 7) << 8
            old[FIRST_DATAGRAM + 1] = old[FIRST_DATAGRAM + 13 + size] = index
            return bytes(old)

        bench.between = stale
        await _watched(bench, 5)
        assert bench.named("stale_frame")
        assert (bench.image.axes["age"] == 4).all()
        bench.between = None
        await bench.run(2)
        assert (bench.image.axes["age"] == 0).all()

    run(main)


def test_a_frame_that_left_late_carries_a_later_sample_and_is_counted_so() -> None:
    """The host stops us for 3 ms between computing and sending: what comes back was sampled by the
    SYNC0 before the frame passed, not by that of the tick that sent it."""

    async def main() -> None:
        bench = await _enabled()
        await bench.run(10)
        held = bench.fieldbus._wire
        assert isinstance(held, DeterministicMaster)
        usual = held._frame_ns
        held._frame_ns = usual + 3 * PERIOD_NS
        await bench.run(1)
        held._frame_ns = usual
        # The three ticks in between were missed.
        bench.tick += 3
        bench.due_ns += 3 * PERIOD_NS
        await bench.run(1)
        assert (bench.image.axes["age"] == 0).all()
        assert (bench.image.axes["state"] == AxisState.OPERATION_ENABLED).all()

    run(main)


def test_the_time_of_a_sample_is_that_of_the_sync0_before_its_frame() -> None:
    """A frame that leaves a period late carries the next sample, two periods after the last one,
    and the next frame on time the same again. Else a drum's rate would be twice what it is."""

    async def main() -> None:
        bench = await _enabled()
        await bench.run(10)
        held = bench.fieldbus._wire
        assert isinstance(held, DeterministicMaster)
        usual = held._frame_ns
        times = []
        for late in (0, 0, PERIOD_NS, 0, 0):
            held._frame_ns = usual + late
            await bench.run(1)
            times.append(bench.image.axes["sampled_ns"].copy())
            assert (bench.image.axes["age"] == 0).all()
        held._frame_ns = usual
        await bench.run(1)
        times.append(bench.image.axes["sampled_ns"].copy())
        steps = np.diff(times, axis=0) // PERIOD_NS
        assert [set(step.tolist()) for step in steps] == [{1}, {1}, {2}, {0}, {1}]

    run(main)


def test_a_frame_close_to_sync0_leaves_the_time_of_its_sample_in_doubt() -> None:
    async def main() -> None:
        bench = await _enabled()
        await bench.run(10)
        held = bench.fieldbus._wire
        assert isinstance(held, DeterministicMaster)
        assert (bench.image.axes["doubt_ns"] == 0).all()
        held._frame_ns = SYNC0_NS + 5_000
        await bench.run(2)
        assert (bench.image.axes["doubt_ns"] == PERIOD_NS).all()

    run(main)


def test_a_slave_that_falls_to_safeop_is_named_and_brought_back() -> None:
    async def main() -> None:
        bench = await _enabled()
        bench.inject("state_drop", node=3, state="safe_op", code=0x1B)
        await until(bench, lambda: bool(bench.named("slave_left_op")), 20)
        event = bench.named("slave_left_op")[0]
        assert event.where == "tonus0/3"
        assert "SAFEOP + ERROR (AL status 0x001B: sync manager watchdog expired" in event.text
        assert (
            bench.image.axes["state"][2] == AxisState.LOST or bench.fieldbus._exchange.untrusted[2]
        )
        await until(bench, lambda: bool(bench.named("slave_recovered")), 100)
        assert bench.segment.slaves[2].state == State.OP
        await bench.run(5)
        assert bench.image.axes["state"][2] != AxisState.LOST
        _ends_with_its_reaction(bench)

    run(main)


def test_by_policy_stop_it_is_left_until_the_operator_resets() -> None:
    async def main() -> None:
        bench = await _enabled({"fieldbus.master.state_policy": "stop"})
        bench.inject("state_drop", node=3, state="safe_op", code=0x1A)
        await _watched(bench, 100)
        assert bench.named("slave_left_op")
        assert not bench.named("slave_recovered")
        assert bench.image.axes["state"][2] == AxisState.LOST
        await beside(bench, bench.fieldbus.recover())
        assert [event.where for event in bench.named("recovered")] == ["tonus0/3"]
        assert bench.segment.slaves[2].state == State.OP

    run(main)


def test_one_that_falls_again_and_again_is_given_up() -> None:
    async def main() -> None:
        bench = await _enabled()
        for _ in range(5):
            bench.inject("state_drop", node=5, state="safe_op", code=0x1A)
            await _watched(bench, 60)
        assert [event.where for event in bench.named("slave_given_up")] == ["tonus0/5"]
        assert bench.segment.slaves[4].state == State.SAFE_OP

    run(main)


def test_a_power_loss_silences_all_behind_it_and_a_reset_configures_them_anew() -> None:
    async def main() -> None:
        bench = await _enabled()
        bench.inject("power_loss", node=9, duration=0.05)
        await _watched(bench, 60)
        assert {event.where for event in bench.named("slave_silent")} == {"tonus0/9", "tonus0/10"}
        assert bench.named("wrong_working_counter")
        assert not (bench.image.axes["state"] == AxisState.LOST).any(), "all drives are before it"
        assert (bench.image.axes["age"] == 0).all()
        assert (bench.image.cells["age"][:8] > 20).all()
        await beside(bench, bench.fieldbus.recover())
        assert not bench.named("recovery_failed")
        # The tenth was only out of reach: its watchdog is all that may have acted.
        assert "tonus0/9" in {event.where for event in bench.named("recovered")}
        await bench.run(20)
        assert (bench.image.axes["age"] == 0).all()
        assert [slave.state for slave in bench.segment.slaves] == [State.OP] * 10

    run(main)


def test_behind_a_broken_cable_measurements_age_and_before_it_they_stay_fresh() -> None:
    async def main() -> None:
        bench = await _enabled()
        bench.inject("power_loss", node=5)
        ages = []
        for _ in range(60):
            await _watched(bench, 1)
            ages.append(bench.image.axes["age"].tolist())
        assert max(max(each[:4]) for each in ages) <= 1, "until it is known who is missing"
        assert all(age == 0 for each in ages[3:] for age in each[:4])
        assert all(age > 50 for age in ages[-1][4:])
        lost = bench.image.axes["state"] == AxisState.LOST
        assert lost.tolist() == [False] * 4 + [True] * 4
        assert (bench.image.cells["age"] > 50).all()
        sent = [int.from_bytes(data[2:4], "little") for data in bench.fieldbus._outputs[:8]]
        assert all(sent[:4])
        assert not any(sent[4:])

    run(main)


def test_a_drive_that_leaves_op_takes_no_other_with_it() -> None:
    async def main() -> None:
        bench = await _enabled({"fieldbus.master.state_policy": "stop"})
        bench.inject("state_drop", node=5, state="safe_op", code=0x1A)
        ages = []
        for _ in range(20):
            await _watched(bench, 1)
            ages.append(bench.image.axes["age"].tolist())
        assert max(max(each) for each in ages) <= 1, "in SAFEOP it is measured as before"
        lost = bench.image.axes["state"] == AxisState.LOST
        assert lost.tolist() == [axis == 4 for axis in range(8)]

    run(main)


def test_inputs_are_used_only_where_the_counter_is_that_of_those_who_are_there() -> None:
    async def main() -> None:
        bench = await _enabled()
        bench.inject("power_loss", node=9)

        await _watched(bench, 5)
        assert (bench.image.axes["age"] == 0).all()
        bench.between = _one_drive_less
        await _watched(bench, 5)
        assert (bench.image.axes["age"] == 4).all()

    run(main)


def test_a_drive_with_power_lost_comes_back_with_clock_and_settings() -> None:
    async def main() -> None:
        bench = await _enabled()
        bench.inject("power_loss", node=1, duration=0.05)
        await _watched(bench, 80)
        await beside(bench, bench.fieldbus.recover())
        assert not bench.named("recovery_failed"), bench.named("recovery_failed")
        await bench.run(300)
        assert [slave.state for slave in bench.segment.slaves] == [State.OP] * 10
        assert (bench.image.axes["age"] == 0).all()
        assert await bench.fieldbus.sdo_read(0, 0x6060, 0) == b"\x0a"

    run(main)


def test_a_cable_break_names_everyone_behind_it() -> None:
    async def main() -> None:
        bench = await _enabled()
        bench.inject("cable_break", behind=6)
        await _watched(bench, 40)
        silent = {event.where for event in bench.named("slave_silent")}
        assert silent == {f"tonus0/{number}" for number in (7, 8, 9, 10)}

    run(main)


RING = {"fieldbus.redundant_interface": "tonus0r"}


@pytest.mark.parametrize("behind", [0, 6, 10])
def test_a_ring_bridges_a_cable_break_and_tells_where_it_is(behind: int) -> None:
    async def main() -> None:
        bench = await _enabled(RING)
        bench.inject("cable_break", behind=behind, duration=0.2)
        for _ in range(150):
            await bench.run(1)
            assert (bench.image.axes["state"] == AxisState.OPERATION_ENABLED).all()
            assert (bench.image.axes["age"] <= 1).all()
            assert (bench.image.cells["age"] <= 1).all()
        ends = ["tonus0", *(f"tonus0/{number}" for number in range(1, 11)), "tonus0r"]
        (event,) = bench.named("ring_open")
        assert event.where == "tonus0"
        assert event.text.startswith(f"no cable between {ends[behind]} and {ends[behind + 1]};")
        assert {event.name for event in bench.events} == {"ring_open"}
        await bench.run(200)
        assert bench.named("ring_closed")
        _ends_with_its_reaction(bench)

    run(main)


def test_a_ring_with_two_breaks_names_those_between_them() -> None:
    async def main() -> None:
        bench = await _enabled(RING)
        bench.inject("cable_break", behind=3)
        await _watched(bench, 150)
        bench.inject("cable_break", behind=6)
        await _watched(bench, 40)
        silent = {event.where for event in bench.named("slave_silent")}
        assert silent == {f"tonus0/{number}" for number in (4, 5, 6)}
        lost = bench.image.axes["state"] == AxisState.LOST
        assert lost.tolist() == [axis in (3, 4, 5) for axis in range(8)]
        assert (bench.image.axes["age"][~lost] == 0).all()

    run(main)


def test_in_a_ring_a_slave_without_power_silences_only_itself() -> None:
    async def main() -> None:
        bench = await _enabled(RING)
        bench.inject("power_loss", node=4, duration=0.05)
        await _watched(bench, 80)
        assert {event.where for event in bench.named("slave_silent")} == {"tonus0/4"}
        await beside(bench, bench.fieldbus.recover())
        assert not bench.named("recovery_failed"), bench.named("recovery_failed")
        await bench.run(20)
        assert [slave.state for slave in bench.segment.slaves] == [State.OP] * 10

    run(main)


def test_a_drive_error_is_told_in_words() -> None:
    async def main() -> None:
        bench = await _enabled()
        bench.inject("drive_error", node=2, code=0x3210)
        await bench.run(10)
        event = bench.named("drive_error")[0]
        assert event.where == "tonus0/2"
        assert "0x3210: overvoltage" in event.text
        assert bench.image.axes["error_code"][1] == 0x3210

    run(main)


def test_a_clock_that_runs_off_is_told() -> None:
    async def main() -> None:
        bench = await _enabled({"fieldbus.clocks.limit_ns": 20})
        bench.inject("clock_drift", node=6, drift_ppm=900.0)
        await until(bench, lambda: bool(bench.named("clock_astray")), 300)
        assert "tonus0/6" in {event.where for event in bench.named("clock_astray")}

    run(main)


def test_random_loss_of_frames_never_lets_a_stale_torque_out() -> None:
    async def main() -> None:
        bench = await _enabled()
        bench.inject("loss", probability=0.4, duration=0.3)
        await _watched(bench, 320)
        assert bench.named("frame_lost")
        await bench.run(50)
        assert (bench.image.axes["age"] == 0).all()

    run(main)
