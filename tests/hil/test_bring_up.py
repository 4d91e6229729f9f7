"""The master on the lab's timed buses, in virtual time: bring-up, enabling, pulling a node."""

from __future__ import annotations

import pytest
from hil.can_bench import CONFIG, Bench, enabled, on_lab

from tonus.drivers.errors import BringUpError
from tonus.drivers.process_image import AxisCommand, AxisState


def test_all_drives_are_brought_to_operation_enabled_and_back() -> None:
    async def script(bench: Bench) -> None:
        await enabled(bench)
        bench.image.commands["command"] = AxisCommand.DISABLE
        await bench.ticks(30)
        assert set(bench.image.axes["state"]) == {AxisState.SWITCH_ON_DISABLED}
        assert bench.fieldbus.take_events() == []

    on_lab(script)


def test_two_runs_exchange_the_same_frames_at_the_same_times() -> None:
    first, second = on_lab(enabled).frames, on_lab(enabled).frames
    assert len(first) > 1000
    assert first == second


def test_a_node_that_is_pulled_is_lost_and_told() -> None:
    async def script(bench: Bench) -> None:
        await enabled(bench)
        bench.lab.unplug("can1", 3)
        await bench.ticks(CONFIG.control.freshness.measurement_ticks + 3)
        states = bench.image.axes["state"].tolist()
        assert states.pop(2) == AxisState.LOST
        assert set(states) == {AxisState.OPERATION_ENABLED}
        await bench.ticks(300)
        told = [(event.name, event.where) for event in bench.fieldbus.take_events()]
        assert ("heartbeat_lost", "can1/3") in told

    on_lab(script)


def test_a_node_that_is_missing_is_named() -> None:
    async def script(bench: Bench) -> None:
        bench.lab.unplug("can3", 25)
        with pytest.raises(BringUpError, match=r"^1 of 17 .* can3/25 \(load cell 8\): missing"):
            await bench.fieldbus.start(lambda _: None)

    on_lab(script)
