"""Faults of the robot itself, through the lab's door: whether, what, where, and how they end."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from lab_bench import Bench

from tonus.config import load
from tonus.config.faults import KINDS
from tonus.config.schema.faults import FAULT
from tonus.config.schema.lab import LabScript
from tonus.config.schema.scenario import Scenario
from tonus.sim.devices.tracker import DATAGRAM, VALID
from tonus.sim.errors import LabError
from tonus.sim.lab.door import Door
from tonus.tools.check.rules import check_parts

CONTACT = load("config/can.yaml", scenario="contact")[1].lab
DIRECT = "config/direct.yaml"
LASTING: dict[str, dict[str, Any]] = {
    "drum_jam": {"axis": 1},
    "drum_friction": {"axis": 1, "force": 20.0, "over": 0.005},
    "motor_weak": {"axis": 1, "gain": -0.5},
    "brake_weak": {"axis": 1, "gain": 0.5},
    "sto": {"axis": 1},
    "cell_gain": {"cell": 1, "gain": 1.5},
    "cell_offset": {"cell": 8, "force": 9.0, "over": 0.005},
    "cell_frozen": {"cell": 1},
    "encoder_frozen": {"axis": 1},
    "tracker_hidden": {},
    "tracker_shift": {"shift": [0.01, 0.0, 0.0]},
    "phantom_hit": {"distance": 0.01, "speed": 1.0},
}
PASSING: dict[str, dict[str, Any]] = {
    "cable_cut": {"axis": 1},
    "drum_slip": {"axis": 1, "length": -0.01},
    "encoder_slip": {"axis": 1, "angle": 0.2, "over": 0.01},
}
PUSH = {"force": [5.0, 0.0, 0.0], "point": [0.0, 0.1, 0.0], "rise": 0.01, "duration": 0.03}
BRAKED = {"robot.brake": {"torque": 0.4, "opening_ms": 40.0, "closing_ms": 20.0}}
BUSES = ["can", "direct", "mixed", "ethercat"]


def inject(bench: Bench, kind: str, **fields: Any) -> None:
    bench.lab.inject(FAULT.validate_python({"kind": kind, **fields}))


def outside(bench: Bench) -> bytes:
    """All that is broken about the robot."""
    plant = bench.lab.plant
    p = plant.parameters
    names = ("coulomb", "torque_per_amp", "cell_gain", "cell_offset", "encoder_gain", "slip_rate")
    names += ("contact_rate", "pushed", "axial_stiffness", "brake_torque")
    tracker = bench.lab.tracker
    kept = [p[name].tobytes() for name in names]
    kept += [
        plant.state["jammed"].tobytes(),
        (0.0 + np.round(plant.state["contact_shift"], 9)).tobytes(),
    ]
    kept.append(bytes(drive.objects.number(0x3202, 1) for drive in bench.lab.drives))
    return b"".join([*kept, bytes([tracker.blocked]), bench.lab._tracker.shift.tobytes()])


def test_every_kind_of_the_robot_is_tried_here() -> None:
    robot = {name for name, kind in KINDS.items() if not kind.has("channel")}
    assert robot == {*LASTING, *PASSING, "load", "put_back"}


@pytest.mark.parametrize("bus", BUSES)
def test_every_kind_can_happen_on_every_bus(bus: str) -> None:
    # Nobody holds the relay of the STO circuit here: it would be open all the time.
    bridged = {"sto_relay": None} if bus == "ethercat" else {}
    with Bench(f"config/{bus}.yaml", CONTACT, overrides=BRAKED | bridged) as bench:
        for kind, fields in (LASTING | PASSING | {"load": PUSH}).items():
            before = outside(bench)
            inject(bench, kind, **fields)
            bench.wait(4)
            if kind not in ("cell_frozen", "encoder_slip"):
                assert outside(bench) != before, kind
        bench.wait(20)
        assert bench.lab.plant.cut.tolist() == [0, 1, 0, 0, 0, 0, 0, 0]
        assert bench.lab.plant.state["slipped"][0, 1] != 0.0


@pytest.mark.parametrize("kind", LASTING)
@pytest.mark.parametrize("ending", ["duration", "clear", "replaced"])
def test_what_lasts_is_told_and_ends(kind: str, ending: str) -> None:
    with Bench(DIRECT, CONTACT, overrides=BRAKED) as bench:
        sound = outside(bench)
        fields = LASTING[kind]
        if ending == "duration":
            inject(bench, kind, **fields, duration=0.02)
            (told,) = bench.lab.faults()
            assert told["fault"]["kind"] == kind
            bench.wait(19)
            assert len(bench.lab.faults()) == 1
            bench.wait(2)
        elif ending == "clear":
            inject(bench, kind, **fields)
            bench.wait(20)
            inject(bench, "clear", channel=None)
        else:
            inject(bench, kind, **fields, duration=0.01)
            bench.wait(5)
            inject(bench, kind, **fields)
            bench.wait(20)
            assert len(bench.lab.faults()) == 1, "the first one's time does not end the second"
            inject(bench, "clear")
        assert not bench.lab.faults()
        bench.wait(20)
        assert outside(bench) == sound


def test_clearing_a_channel_leaves_the_robot_as_it_is() -> None:
    with Bench() as bench:
        inject(bench, "drum_jam", axis=0)
        inject(bench, "loss", channel="can0")
        inject(bench, "clear", channel="can0")
        assert [each["fault"]["kind"] for each in bench.lab.faults()] == ["drum_jam"]


def test_a_push_rises_lasts_and_falls() -> None:
    with Bench(DIRECT) as bench:
        inject(bench, "load", **PUSH)
        seen = []
        for _ in range(45):
            bench.wait(1)
            seen.append(float(bench.lab.plant.load_wrench[0]))
        assert seen[4] == pytest.approx(2.5, abs=0.3)
        assert seen[12:29] == [5.0] * 17
        assert seen[34] == pytest.approx(2.5, abs=0.5)
        assert seen[42] == 0.0
        assert not bench.lab.faults()


def test_the_devices_show_what_a_broken_sensor_shows() -> None:
    with Bench(DIRECT) as bench, Bench(DIRECT) as sound:
        samples = bench.lab.samples
        per_radian = samples.per_radian[2] * bench.config.robot.gearbox.ratio
        inject(bench, "cell_offset", cell=8, force=30.0)
        inject(bench, "encoder_slip", axis=2, angle=0.5)
        bench.wait(5)
        sound.wait(5)
        words, healthy = samples.at(bench.now), sound.lab.samples.at(sound.now)
        assert words[2 * 8 + 8] - healthy[2 * 8 + 8] == pytest.approx(3000, abs=1)
        assert words[2] - healthy[2] == pytest.approx(0.5 * per_radian, abs=1.0)
        assert samples.position(2) == words[2]


def test_the_tracker_is_off_and_hidden() -> None:
    with Bench(DIRECT) as bench:

        def seen() -> tuple[bool, float]:
            bench.wait(50)
            _, _, _, _, flags, _, x, *_ = DATAGRAM.unpack(bench.lab.tracker.poll(bench.now)[-1])
            return bool(flags & VALID), float(x)

        assert seen() == (True, pytest.approx(0.0, abs=3e-4))
        inject(bench, "tracker_shift", shift=[0.05, 0.0, 0.0])
        assert seen() == (True, pytest.approx(0.05, abs=3e-4))
        inject(bench, "tracker_hidden", duration=0.05)
        assert not seen()[0]
        assert seen()[0]


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"kind": "cable_cut", "axis": 8}, "no axis 8; there are 0 to 7"),
        ({"kind": "cell_gain", "cell": 9, "gain": 1.0}, "no cell 9; there are 0 to 8"),
        ({"kind": "phantom_hit", "distance": 0.01, "speed": 0.1}, "has no phantom; give it one"),
        ({"kind": "brake_weak", "axis": 1, "gain": 0.5}, "axis 1 has no holding brake; give"),
    ],
)
def test_what_the_robot_does_not_have_is_refused(fault: dict[str, Any], words: str) -> None:
    with Bench(DIRECT) as bench:
        with pytest.raises(LabError, match=words):
            bench.lab.inject(FAULT.validate_python(fault))
        config, hold = load(DIRECT, scenario="hold")
        data = hold.model_dump() | {"lab": {"faults": [fault]}}
        (found,) = [
            each
            for each in check_parts(config, Scenario.model_validate(data))
            if each.rule == "faults"
        ]
        assert not found.ok
        sound = {**fault, "axis": 7} if "axis" in fault else {**fault, "cell": 8}
        if fault["kind"] == "phantom_hit":
            data["lab"]["phantom"] = CONTACT.phantom
            sound = fault
        if fault["kind"] == "brake_weak":
            config = load(DIRECT, overrides=BRAKED)[0]
        data["lab"]["faults"] = [sound]
        (found,) = [
            each
            for each in check_parts(config, Scenario.model_validate(data))
            if each.rule == "faults"
        ]
        assert found.ok


def test_the_door_tells_where() -> None:
    with Bench(DIRECT, CONTACT) as bench:
        kinds = Door(bench.lab).request({"op": "kinds"})["kinds"]
        assert kinds["drum_slip"]["where"] == [str(axis) for axis in range(8)]
        assert kinds["cell_frozen"]["where"][-1] == "8"
        assert kinds["sto"]["where"] == [str(axis) for axis in range(8)]
        assert kinds["brake_weak"]["where"] == []
        assert kinds["phantom_hit"]["where"] == ["phantom"]
        assert kinds["tracker_hidden"]["where"] == ["tracker"]
        assert kinds["load"]["where"] == ["platform"]
    with Bench(DIRECT) as bench:
        kinds = Door(bench.lab).request({"op": "kinds"})["kinds"]
        assert kinds["phantom_hit"]["where"] == []


def test_a_scenario_breaks_the_robot_at_its_time() -> None:
    script = LabScript(faults=(FAULT.validate_python({"kind": "cable_cut", "axis": 3, "at": 0.1}),))
    with Bench(script=script) as bench:
        bench.configure_all()
        bench.enable()
        bench.wait(95)
        assert not bench.lab.plant.cut.any()
        bench.wait(10)
        assert bench.lab.plant.cut[3] == 1.0
