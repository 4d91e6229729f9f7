"""What an identification looks like: JSON, YAML, table, figure."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
import yaml
from rich.console import Console

from tonus.tools.identify import Estimate, Identification
from tonus.tools.identify.estimate import Fit
from tonus.tools.identify.figure import draw
from tonus.tools.identify.response import Line, Response
from tonus.tools.identify.shown import show
from tonus.tools.identify.written import rounded, to_json, to_yaml

EA = Estimate(
    "axial_stiffness",
    "cable stiffness EA",
    "N",
    3412.345,
    23.4,
    3600.0,
    (3400.0, math.nan),
    truth=3410.0,
    key="robot.cable.axial_stiffness",
)
VAGUE = Estimate(
    "coulomb_friction", "Coulomb friction F_c", "N", 1.0, 3.0, 1.5, key="lab.plant.coulomb_friction"
)
UNKNOWN = Estimate(
    "load_friction", "load friction μ", "", 0.03, 0.001, key="lab.plant.load_friction"
)
BY_WEIGHT = Estimate("platform_mass", "by weight", "kg", 2.30, 0.05, 2.35)
BY_INERTIA = Estimate("moved_mass", "by inertia", "kg", 2.3412, 0.004, 2.35)
FORTH = Estimate(
    "efficiency_driving", "driving", "", 0.78, 0.002, 0.8, key="robot.gearbox.efficiency"
)
BACK = Estimate(
    "efficiency_driven", "driven back", "", 0.76, 0.002, 0.8, key="robot.gearbox.efficiency"
)
FIT = Fit(
    np.array([2.0, 100.0, 3000.0]),
    np.ones(3),
    np.zeros(1),
    np.zeros(1, np.int64),
    np.zeros((1, 3)),
    2.0,
)
RESPONSE = Response("loop", (Line(0.5, 3e-4 - 3e-5j, 0.5),), FIT, 0.99)
FOUND = Identification(
    (Path("a.mcap"),),
    (EA, VAGUE, UNKNOWN, BY_WEIGHT, BY_INERTIA, FORTH, BACK),
    (RESPONSE,),
    (),
    ("closed loop: nothing",),
)


def test_the_json_says_none_for_what_is_not_known() -> None:
    text = json.dumps(to_json(FOUND), allow_nan=False)
    first = json.loads(text)["estimates"][0]
    assert first["each"] == [3400.0, None]
    assert first["error"] == pytest.approx(2.345)
    assert first["verdict"] == "differs -5.2 %"
    line = json.loads(text)["responses"][0]["lines"][0]
    assert line["phase_deg"] == pytest.approx(-5.71, abs=0.01)


def test_the_yaml_holds_what_is_sure_enough_and_its_uncertainty() -> None:
    text = to_yaml(FOUND)
    assert yaml.safe_load(text) == {
        "robot": {
            "cable": {"axial_stiffness": 3412.0},
            "platform": {"mass": 2.3412},
            "gearbox": {"efficiency": 0.77},
        }
    }
    assert "# N ± 23, was 3600" in text


def test_what_axes_have_as_their_own_is_written_for_each_of_them() -> None:
    key = "robot.axes.{}.drum.inertia"
    own = Estimate("drum_inertia", "J", "kg m²", 0.0071, 1e-5, 0.007, key=key, axes=(4, 6))
    rest = Estimate(
        "drum_inertia", "J", "kg m²", 0.0043, 1e-5, 0.0042, key="robot.drum.inertia", axes=(0, 1)
    )
    text = to_yaml(replace(FOUND, estimates=(rest, own)))
    assert yaml.safe_load(text) == {
        "robot": {
            "drum": {"inertia": 0.0043},
            "axes": {4: {"drum": {"inertia": 0.0071}}, 6: {"drum": {"inertia": 0.0071}}},
        }
    }
    assert text.count("was 0.007\n") == 2
    assert text.count("was 0.0042\n") == 1
    assert text.startswith("# Identified from a.mcap\n")


def test_the_table_shows_value_interval_configured_truth_and_verdict() -> None:
    console = Console(file=StringIO(), width=140)
    show(console, FOUND, truth=True)
    printed = console.file.getvalue()  # type: ignore[attr-defined]
    row = next(line for line in printed.splitlines() if "EA" in line)
    for words in ("3412", "23", "3600", "3410", "+0.07 %", "differs -5.2 %"):
        assert words in row
    assert "uncertain" in printed
    assert "1 % of the force's power unexplained; peaks at 0.50 Hz" in printed
    assert "closed loop: nothing" in printed


def test_a_response_without_a_clear_line_can_be_drawn(tmp_path: Path) -> None:
    draw(FOUND, tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("value", "half_width", "shown"),
    [(3412.345, 23.4, 3412.0), (0.0042006, 8.9e-6, 0.0042006), (131.2, 130.0, 130.0)],
)
def test_values_are_rounded_to_the_second_figure_of_their_uncertainty(
    value: float, half_width: float, shown: float
) -> None:
    assert rounded(value, half_width) == pytest.approx(shown, rel=1e-9)
