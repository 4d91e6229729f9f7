"""`tonus log identify` on runs in the lab: it recovers what the plant was given."""

from __future__ import annotations

import json
import sys
from contextlib import redirect_stdout
from io import StringIO
from itertools import accumulate, cycle
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.loop import QUICK
from tests.scripted import scripted
from tonus.config import load
from tonus.tools.cli.main import main
from tonus.tools.testing.player import Player

pytestmark = [
    pytest.mark.tonus(config="config/direct.yaml", overrides=QUICK),
    pytest.mark.tonus_expect("*"),
    pytest.mark.wide,
]

GIVEN: dict[str, Any] = {
    "lab.plant.stiffness_scale": 1.12,
    "lab.plant.damping_scale": 2.0,
    "lab.plant.mass_scale": 1.15,
    "lab.plant.coulomb_friction": 2.4,
    "lab.plant.load_friction": 0.05,
    "robot.drum.inertia": 0.0060,
    "robot.drum.viscous_friction": 0.018,
    "robot.gearbox.efficiency": 0.72,
}
"""Of these the daemon is told those of ``robot``, but the identification uses none."""
SWEEP = (0.8, 0.65, 0.5, 0.4, 0.3, 0.25, 0.2, 0.3, 0.4, 0.5)
"""s between the turns of the load"""
TOLERANCE = {
    "platform_mass": 0.01,
    "moved_mass": 0.01,
    "axial_stiffness": 0.01,
    "cable_damping": 0.05,
    "drum_inertia": 0.01,
    "viscous_friction": 0.04,
    "coulomb_friction": 0.15,
    "load_friction": 0.15,
    "efficiency_driving": 0.01,
    "efficiency_driven": 0.01,
}
"""largest error as a share of the true value"""


def swept() -> dict[str, Any]:
    """A load of 15 N either way, from 3 s on."""
    times = accumulate(SWEEP, initial=3.0)
    profile = [{"at": 2.9, "force": 0.0}]
    profile += [{"at": at, "force": f} for at, f in zip(times, cycle((15.0, -15.0)), strict=False)]
    way, point = [1.0, 0.0, 1.0], [0.0, 0.0, 0.0]
    return {"load": {"direction": way, "point": point, "profile": profile}}


@pytest.fixture(scope="module")
def logs(tonus_shared_run: Player) -> list[Path]:
    """The same robot moved by sines, and pushed."""
    moved = tonus_shared_run("identify_motion", overrides=GIVEN, duration=10.0)
    pushed = scripted("identify_load", lab=swept())
    runs = (moved, tonus_shared_run(pushed, overrides=GIVEN, duration=4.5))
    assert [run.state for run in runs] == ["STANDBY", "STANDBY"]
    return [run.path for run in runs]


def of(paths: list[Path], out: Path) -> dict[str, Any]:
    """What the command prints as JSON, and its folder."""
    before, printed = sys.argv, StringIO()
    sys.argv = [
        "tonus",
        "log",
        "identify",
        *map(str, paths),
        "--truth",
        "--json",
        "--out",
        str(out),
    ]
    try:
        with pytest.raises(SystemExit) as ending, redirect_stdout(printed):
            main()
    finally:
        sys.argv = before
    assert not ending.value.code
    result: dict[str, Any] = json.loads(printed.getvalue())
    assert result == json.loads((out / "identify.json").read_text())
    return result | {"out": out}


@pytest.fixture(scope="module")
def found(logs: list[Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return of(logs, tmp_path_factory.mktemp("out"))


@pytest.mark.parametrize("name", TOLERANCE)
def test_it_recovers_what_the_plant_was_given(found: dict[str, Any], name: str) -> None:
    estimate = next(e for e in found["estimates"] if e["name"] == name)
    allowed = TOLERANCE[name] * estimate["truth"]
    assert abs(estimate["error"]) <= allowed
    assert abs(estimate["error"]) <= estimate["half_width"]
    assert estimate["half_width"] <= 3.0 * allowed, "and says so with confidence"


def test_the_truth_beside_it_is_what_the_plant_was_given(found: dict[str, Any]) -> None:
    truth = {e["name"]: e["truth"] for e in found["estimates"]}
    assert truth["platform_mass"] == pytest.approx(1.15 * 2.35)
    assert truth["axial_stiffness"] == pytest.approx(1.12 * 3600.0)
    assert truth["cable_damping"] == pytest.approx(2.0 * 6.0)
    assert truth["coulomb_friction"] == pytest.approx(2.4)
    assert truth["drum_inertia"] == pytest.approx(0.0060)
    assert truth["efficiency_driven"] == pytest.approx(0.72)


def test_values_that_the_configuration_has_wrong_are_named(found: dict[str, Any]) -> None:
    verdicts = {e["name"]: e["verdict"] for e in found["estimates"]}
    assert verdicts["axial_stiffness"].startswith("differs +1")
    assert verdicts["cable_damping"].startswith("differs +")
    assert verdicts["moved_mass"].startswith("differs +1")
    assert verdicts["drum_inertia"] == "as configured"


@pytest.mark.parametrize(("name", "share"), [("loop_stiffness", 0.02), ("loop_damping", 0.1)])
def test_what_a_load_feels_is_found_without_measuring_the_load(
    found: dict[str, Any], name: str, share: float
) -> None:
    """The truth is the response between the lab's true load and true position."""
    estimate = next(e for e in found["estimates"] if e["name"] == name)
    assert abs(estimate["error"]) <= share * estimate["truth"]
    assert abs(estimate["error"]) <= estimate["half_width"]


def test_nothing_holds_on_to_the_platform_in_free_air(found: dict[str, Any]) -> None:
    stiffness = next(e for e in found["estimates"] if e["name"] == "outer_stiffness")
    assert abs(stiffness["value"]) < 1.0


def test_the_fragment_is_yaml_for_the_configuration(found: dict[str, Any]) -> None:
    fragment = yaml.safe_load((found["out"] / "identify.yaml").read_text())
    assert fragment["robot"]["cable"]["axial_stiffness"] == pytest.approx(1.12 * 3600.0, rel=0.01)
    assert fragment["robot"]["cable"]["damping"] == pytest.approx(2.0 * 6.0, rel=0.05)
    assert fragment["robot"]["drum"]["inertia"] == pytest.approx(0.0060, rel=0.01)
    assert fragment["lab"]["plant"]["load_friction"] == pytest.approx(0.05, rel=0.15)
    overrides = [f"{a}.{b}.{c}" for a, s in fragment.items() for b, t in s.items() for c in t]
    load("config/direct.yaml", overrides=dict.fromkeys(overrides, 1.0))


def test_the_figure_is_drawn(found: dict[str, Any]) -> None:
    assert (found["out"] / "identify.png").read_bytes().startswith(b"\x89PNG")
    assert {response["kind"] for response in found["responses"]} == {"platform", "loop"}


def test_six_cables_are_said_not_to_show_their_damping(tonus_run: Player, tmp_path: Path) -> None:
    run = tonus_run("identify_motion", config="config/six.yaml", duration=4.0)
    said = of([run.path], tmp_path)
    assert all(e["name"] != "cable_damping" for e in said["estimates"])
    assert any("more than six cables" in note for note in said["notes"])


@pytest.mark.long
def test_sines_against_the_phantom_give_its_stiffness_and_damping(
    tonus_run: Player, tmp_path: Path
) -> None:
    run = tonus_run("identify_phantom", duration=8.0)
    estimates = {e["name"]: e for e in of([run.path], tmp_path)["estimates"]}
    for name, share in (("outer_stiffness", 0.01), ("outer_damping", 0.1), ("moved_mass", 0.02)):
        assert abs(estimates[name]["error"]) <= share * estimates[name]["truth"]
        assert abs(estimates[name]["error"]) <= estimates[name]["half_width"]
    assert estimates["outer_stiffness"]["truth"] == pytest.approx(210.0)
