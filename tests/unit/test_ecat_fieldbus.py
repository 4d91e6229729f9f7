"""The EtherCAT fieldbus against the lab's segment: bring-up, exchange, delay, clocks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from segment_bench import PERIOD_NS, SegmentBench, run

from tonus.drivers.errors import BringUpError, DriverError, SdoAbortError
from tonus.drivers.process_image import AxisCommand, AxisState
from tonus.runtime.timing import clock
from tonus.runtime.timing.scheduler import Scheduler, VirtualPacing
from tonus.runtime.timing.steering import SteeredPacing
from tonus.sim.ethercat.slaves.states import State


def test_ten_slaves_reach_op_and_every_value_is_fresh() -> None:
    async def main() -> None:
        bench = SegmentBench()
        await bench.start()
        await bench.run(50)
        assert [slave.state for slave in bench.segment.slaves] == [State.OP] * 10
        assert not bench.events
        assert (bench.image.axes["age"] == 0).all()
        assert (bench.image.cells["age"] == 0).all()
        assert (bench.image.axes["state"] == AxisState.SWITCH_ON_DISABLED).all()
        await bench.fieldbus.stop()
        assert [slave.state for slave in bench.segment.slaves] == [State.PRE_OP] * 10

    run(main)


def test_a_torque_acts_two_ticks_after_the_sample_it_was_computed_from() -> None:
    """As on CAN: what is published in tick k acts at SYNC0 k+1, not earlier, not later."""

    async def main() -> None:
        bench = SegmentBench()
        await bench.start()
        await bench.enable()
        drive = bench.lab.drives[0]
        target: list[int] = []

        def step(tick: int) -> None:
            target.append(int.from_bytes(drive.objects.read(0x6071, 0), "little", signed=True))
            bench.image.commands["torque"] = 0.05 if tick == first else 0.0

        first = bench.tick + 3
        await bench.run(8, step)
        acting = [number for number, value in enumerate(target) if value]
        # Seen at the start of a tick, before its SYNC0: one tick later than it acted.
        assert len(acting) == 1
        assert acting[0] in (3, 4)

    run(main)


def test_positions_and_forces_are_those_of_the_devices() -> None:
    async def main() -> None:
        bench = SegmentBench()
        await bench.start()
        await bench.enable(0.4)
        await bench.run(200)
        increments = [
            int.from_bytes(drive.objects.read(0x6064, 0), "little", signed=True)
            for drive in bench.lab.drives
        ]
        motor, ratio = bench.config.robot.motor, bench.config.robot.gearbox.ratio
        per_increment = 2 * np.pi / (motor.increments_per_revolution * ratio)
        found = bench.image.axes["angle"]
        assert np.abs(found).max() > 100 * per_increment
        # A tick's motion lies between the sample and now.
        assert np.allclose(found, np.array(increments) * per_increment, rtol=0.02, atol=1e-3)
        assert (np.abs(bench.image.cells["force"][:8]) > 0.1).any()

    run(main)


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (
            {"fieldbus.drive.ethercat.identity.product": 0x61500000},
            "product 0x65510000, not 0x61500000",
        ),
        ({"fieldbus.drive.ethercat.identity.minimum_revision": 0x7FFF0000}, "firmware too old"),
    ],
)
def test_another_device_is_refused_and_the_cable_shown(
    overrides: dict[str, Any], told: str
) -> None:
    async def main() -> None:
        bench = SegmentBench(overrides)
        with pytest.raises(BringUpError, match=told) as refused:
            await bench.start()
        assert "tonus0/1 (drive of axis 0)" in str(refused.value)
        assert "\n" not in str(refused.value)
        assert sum("vendor 0x000000FB" in line for line in bench.said) == 8

    run(main)


def test_a_slave_too_few_is_counted_and_the_cable_shown() -> None:
    async def main() -> None:
        bench = SegmentBench()
        bench.segment.cable.cut(9)
        with pytest.raises(BringUpError, match="9 slaves answer, configured are 10"):
            await bench.start()
        assert any("tonus0/9" in line for line in bench.said)

    run(main)


def test_a_refused_state_is_told_with_its_code_in_words() -> None:
    async def main() -> None:
        bench = SegmentBench()
        bench.inject("state_refusal", node=4, state="safe_op", code=0x1E)
        with pytest.raises(BringUpError, match=r"tonus0/4 .*0x001E: invalid input configuration"):
            await bench.start()

    run(main)


def test_a_refused_object_is_told_with_its_abort_code() -> None:
    async def main() -> None:
        bench = SegmentBench()
        bench.inject("mailbox_abort", node=2, index=0x1A00, code=0x06040041)
        with pytest.raises(BringUpError, match=r"tonus0/2 .*0x06040041"):
            await bench.start()

    run(main)


def test_an_interpolation_period_that_is_neither_0_nor_the_tick_is_refused() -> None:
    async def main() -> None:
        SegmentBench({"fieldbus.drive.interpolation_ms": 1})
        with pytest.raises(DriverError, match="must be 0 or the period"):
            SegmentBench({"fieldbus.drive.interpolation_ms": 2})

    run(main)


def test_objects_are_read_and_written_beside_the_ticks_also_in_segments() -> None:
    async def main() -> None:
        bench = SegmentBench()
        await bench.start()
        fieldbus = bench.fieldbus
        assert await fieldbus.sdo_read(3, 0x1018, 1) == bytes.fromhex("fb000000")
        name = await fieldbus.sdo_read(3, 0x1008, 0)
        assert name.startswith(b"EPOS4")
        await fieldbus.sdo_write(3, 0x605E, 0, b"\1\0")
        assert await fieldbus.sdo_read(3, 0x605E, 0) == b"\1\0"
        with pytest.raises(SdoAbortError, match="0x2FFF:0"):
            await fieldbus.sdo_read(3, 0x2FFF, 0)

    run(main)


def test_sdo_access_survives_lost_frames() -> None:
    async def main() -> None:
        bench = SegmentBench()
        await bench.start()
        drawn = np.random.default_rng(5)
        bench.between = lambda _, answer: None if drawn.random() < 0.2 else answer
        for _ in range(40):
            assert await bench.fieldbus.sdo_read(0, 0x1018, 1) == bytes.fromhex("fb000000")

    run(main)


def test_the_ticks_follow_a_reference_clock_that_drifts() -> None:
    """40 ppm are 40 ns a tick: 160 us in 4000 ticks, of which less than 2 us may be left."""

    async def main() -> None:
        bench = SegmentBench()
        await bench.start()
        bench.inject("clock_drift", node=1, drift_ppm=40.0)
        began = bench.due_ns
        phases: list[int] = []

        def note(_: int) -> None:
            error = bench.fieldbus.phase_error_ns(bench.due_ns)
            assert error is not None
            phases.append(error)

        await bench.run(4000, note)
        assert max(map(abs, phases[2000:])) < 2000
        moved = bench.due_ns - began - 4000 * PERIOD_NS
        assert -200_000 < moved < -120_000
        assert not bench.named("frame_near_sync")

    run(main)


def test_without_steering_a_drifting_clock_meets_the_frame_and_is_told() -> None:
    async def main() -> None:
        bench = SegmentBench({"fieldbus.clocks.pacing": "timer"})
        assert not bench.fieldbus.leads
        await bench.start()
        bench.inject("clock_drift", node=1, drift_ppm=500.0)
        bench._pacing = None
        for _ in range(1500):
            bench.tick += 1
            bench.due_ns += PERIOD_NS
            await VirtualPacing().until(bench.due_ns)
            bench.fieldbus.collect(bench.tick)
            bench.fieldbus.publish(bench.tick)
            bench.events += bench.fieldbus.take_events()
        assert bench.named("frame_near_sync")

    run(main)


def test_a_steered_scheduler_moves_its_ticks_and_skips_none() -> None:
    class Reference:
        """Late by what the ticks have not yet been moved."""

        def phase_error_ns(self, due_ns: int) -> int:
            return (due_ns + PERIOD_NS // 2) % PERIOD_NS - PERIOD_NS // 2

    async def main() -> None:
        config = SegmentBench().config
        clocks = config.fieldbus.clocks  # type: ignore[union-attr]
        pacing = SteeredPacing(VirtualPacing(), Reference(), clocks)
        stopwatch = clock.Stopwatch(running=False)
        scheduler = Scheduler(PERIOD_NS, 10 * PERIOD_NS + 50_000, pacing, stopwatch)
        ticks = [await scheduler.next() for _ in range(2000)]
        assert ticks == list(range(2000))
        assert abs((scheduler.due_ns(1999) % PERIOD_NS + 500_000) % PERIOD_NS - 500_000) < 100
        assert scheduler.misses.own == scheduler.misses.host == 0

    run(main)


def test_a_torque_that_is_no_number_becomes_none() -> None:
    async def main() -> None:
        bench = SegmentBench()
        await bench.start()
        await bench.enable(0.02)
        bench.image.commands["torque"][3] = np.nan
        bench.image.commands["command"] = AxisCommand.ENABLE
        await bench.run(3)
        assert [event.where for event in bench.named("non_finite_torque")] == ["tonus0/4"]
        assert bench.lab.drives[3].objects.read(0x6071, 0) == b"\0\0"

    run(main)
