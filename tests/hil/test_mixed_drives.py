"""Two EPOS4 and six plain CiA 402 drives on one fieldbus: bring-up, runs, a fault and its reset."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hil.can_bench import Bench, enabled, on_lab

from tests.loop import QUICK
from tests.segment_bench import SegmentBench, run, until
from tonus.config import Config, load
from tonus.drivers.errors import BringUpError
from tonus.drivers.process_image import AxisCommand, AxisState
from tonus.tools.testing.player import Player

pytestmark = pytest.mark.wide

EDS = Path(__file__).resolve().parents[1] / "eds"
MIXED = load("config/mixed_drives.yaml")[0]
ENCODER = "incremental encoder 1; a fault reset clears it"


def with_sheet(name: str, **changed: Any) -> Config:
    text = (EDS / name).read_text(encoding="ascii")
    given = {"eds": {"name": name, "text": text}, **changed}
    overrides = {f"fieldbus.drive.{key}": value for key, value in given.items()}
    return load("config/mixed_drives.yaml", overrides=overrides)[0]


SERVO_B: dict[str, Any] = {
    "options": {},
    "scaling": {"torque": "0x6075", "position": "0x6092"},
}


@pytest.mark.parametrize(
    "config",
    [MIXED, with_sheet("servo_a.eds"), with_sheet("servo_b.eds", **SERVO_B)],
    ids=["ours", "a", "b"],
)
def test_every_drive_comes_up_and_turns_alike_whatever_it_counts_in(config: Config) -> None:
    async def script(bench: Bench) -> None:
        await enabled(bench)
        bench.image.commands["torque"] = 0.4
        await bench.ticks(200)
        lab, ratio = bench.lab, config.robot.gearbox.ratio
        true = lab.plant.motor_angle / ratio
        moved = bench.image.axes["angle"]
        assert (abs(moved) > 0.05).all()
        # Between the sample and now a drum turns on by a tick's motion.
        assert moved == pytest.approx(true, rel=0.03, abs=2e-3)
        assert bench.image.axes["torque"] == pytest.approx([0.4] * 8, abs=0.02)

    on_lab(script, config=config)


def test_a_fault_is_reported_in_the_words_of_its_drives_profile_and_reset() -> None:
    async def script(bench: Bench) -> None:
        await enabled(bench)
        bench.lab.nodes["can0", 1].device.fail(0x7320)
        bench.lab.nodes["can1", 5].device.fail(0x7305)
        await bench.ticks(1500)
        states = bench.image.axes["state"]
        assert states[0] == states[4] == AxisState.FAULT
        assert set(states[[1, 2, 3, 5, 6, 7]]) == {AxisState.OPERATION_ENABLED}
        told = {event.where: event.text for event in bench.fieldbus.take_events()}
        assert "position sensor error; power off at once" in told["can0/1"]
        assert ENCODER in told["can1/5"]
        bench.image.commands["command"] = AxisCommand.RESET_FAULT
        await bench.ticks(50)
        assert not set(bench.image.axes["state"]) & {AxisState.FAULT}
        assert not bench.image.axes["error_code"].any()
        bench.image.commands["command"] = AxisCommand.ENABLE
        await bench.ticks(30)
        assert set(bench.image.axes["state"]) == {AxisState.OPERATION_ENABLED}

    on_lab(script, config=MIXED)


def test_a_drive_without_0x603f_is_brought_up_out_of_a_fault() -> None:
    async def script(bench: Bench) -> None:
        said: list[str] = []
        bench.lab.nodes["can1", 3].device.fail(0x7305)
        await bench.fieldbus.start(said.append)
        assert any("can1/3" in line and "0x1000 generic error" in line for line in said)
        bench.image.commands["command"] = AxisCommand.ENABLE
        await bench.ticks(30)
        assert set(bench.image.axes["state"]) == {AxisState.OPERATION_ENABLED}

    on_lab(script, config=with_sheet("servo_b.eds", **SERVO_B))


def test_every_drive_stops_by_itself_when_the_daemon_is_killed() -> None:
    async def script(bench: Bench) -> None:
        await enabled(bench)
        bench.lab.advance(bench.lab.now_ns + 2_000_000_000)
        assert not any(drive.enabled for drive in bench.lab.drives)
        assert not bench.lab.plant.powered.any()

    on_lab(script, config=MIXED)


def test_a_drive_that_is_not_set_up_is_named() -> None:
    async def script(bench: Bench) -> None:
        for drive in bench.lab.drives[6:]:
            drive.objects.find(0x6076, 0).set(0)
        with pytest.raises(BringUpError, match=r"2 of 17 .*can0/7 .*axis 6.* 0x6076:0 reads 0"):
            await bench.fieldbus.start(lambda _: None)

    on_lab(script, config=MIXED)


def test_the_fieldbus_on_ethercat_does_the_same() -> None:
    async def main() -> None:
        bench = SegmentBench(name="config/mixed_drives_ethercat.yaml")
        await bench.start()
        await bench.enable(0.4)
        await bench.run(200)
        true = bench.lab.plant.motor_angle / bench.config.robot.gearbox.ratio
        assert (abs(bench.image.axes["angle"]) > 0.05).all()
        assert bench.image.axes["angle"] == pytest.approx(true, rel=0.03, abs=2e-3)
        bench.inject("drive_error", node=4, code=0x7305)
        await until(bench, lambda: bench.image.axes["state"][3] == AxisState.FAULT)
        assert [event.where for event in bench.named("drive_error")] == ["tonus0/4"]
        assert ENCODER in bench.named("drive_error")[0].text
        bench.image.commands["command"] = AxisCommand.RESET_FAULT
        await bench.run(50)
        assert bench.image.axes["state"][3] == AxisState.SWITCH_ON_DISABLED
        await bench.fieldbus.stop()

    run(main)


@pytest.mark.parametrize(
    ("name", "scenario", "duration"),
    [("mixed_drives", "contact_near", 4.0), ("mixed_drives_ethercat", "sine_x", 0.5)],
)
@pytest.mark.tonus(overrides=QUICK)
@pytest.mark.tonus_expect("envelope")
def test_a_run_goes_as_planned_and_replays_to_the_last_bit(
    name: str, scenario: str, duration: float, tonus_run: Player
) -> None:
    run = tonus_run(scenario, config=f"config/{name}.yaml", duration=duration)
    assert run.state == "STANDBY", run.reason
    peak = float(run.signal("truth", "contact_force").values.max())
    assert peak <= MIXED.control.envelope.contact_limit
    assert (peak > 1.0) == (scenario == "contact_near")
    run.replays()
