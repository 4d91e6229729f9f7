"""References that users bring: their values and limits by hand, and what is wrong with files."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from tonus.config import ConfigError, Scenario, load
from tonus.config.loader import load_scenario
from tonus.runtime.control.compiled import angular_velocity
from tonus.runtime.control.reference import Trajectory, trajectory
from tonus.tools.check.mechanics import scenario_rules

CORNER: dict[str, Any] = {
    "kind": "waypoints",
    "speed": 0.2,
    "acceleration": 0.5,
    "smoothing": 0.1,
    "blend": 0.01,
    "waypoints": [{"position": [0.1, 0.0, 0.0]}, {"position": [0.1, 0.1, 0.0]}],
}
OWN = {"kind": "object", "name": "tests.unit.own_trajectories:Rise", "length": 2.0}
OWN["settings"] = {"height": 0.05, "length": 2.0}
CIRCLE = {"kind": "circle", "normal": [1, 1, 2], "radius": 0.03, "frequency": 0.25, "fade": 2.0}
SHIPPED = ("circle", "tilt", "waypoints", "table")


def scenario(folder: Path, reference: dict[str, Any], duration: float = 10.0) -> Scenario:
    """Loaded from a file in ``folder``, as a user's is."""
    data = {"name": "own", "description": "", "duration": duration, "reference": reference}
    path = folder / "own.yaml"
    path.write_text(yaml.safe_dump(data))
    return load_scenario(str(path))


def follow(folder: Path, reference: dict[str, Any]) -> Trajectory:
    return trajectory(scenario(folder, reference).reference)


def played(follow: Trajectory, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) and motion (n, 3, 3) every millisecond."""
    times = np.arange(0.0, end, 0.001)
    return times, np.array([follow(float(t)) for t in times])


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_one_begins_at_rest_at_home_and_has_its_derivatives(name: str) -> None:
    path, h = trajectory(load_scenario(name).reference), 1e-5
    for part in (path, path.rotation):
        for value in part(0.0)[:2]:
            np.testing.assert_allclose(value, 0.0, atol=1e-12)
        for t in np.linspace(0.0512, 7.0, 200):
            _, rate, bend = part(float(t))
            before, after = part(float(t) - h), part(float(t) + h)
            np.testing.assert_allclose(rate, (after[0] - before[0]) / (2 * h), atol=1e-7)
            np.testing.assert_allclose(bend, (after[1] - before[1]) / (2 * h), atol=1e-3)


def test_a_circle_lies_in_its_plane_at_its_radius(tmp_path: Path) -> None:
    path = follow(tmp_path, CIRCLE)
    for t in np.linspace(2.0, 10.0, 50):
        offset, velocity, _ = path(float(t))
        assert abs(offset @ np.array([1, 1, 2])) < 1e-12
        assert np.linalg.norm(offset) == pytest.approx(0.03)
        assert np.linalg.norm(velocity) == pytest.approx(0.03 * 0.5 * math.pi)
        assert np.cross(offset, velocity) @ np.array([1, 1, 2]) > 0.0


def test_a_straight_way_takes_as_long_as_a_trapezoid(tmp_path: Path) -> None:
    way = {**CORNER, "waypoints": [{"position": [0.2, 0.0, 0.0]}]}
    times, motion = played(follow(tmp_path, way), 3.0)
    still = times[np.linalg.norm(motion[:, 1], axis=1) > 1e-9].max()
    assert still == pytest.approx(0.2 / 0.2 + 0.2 / 0.5 + 0.1, abs=0.01)
    np.testing.assert_allclose(motion[-1, 0], [0.2, 0.0, 0.0], atol=1e-9)


def test_a_corner_is_blended_within_its_limits_and_as_fast_as_they_allow(tmp_path: Path) -> None:
    sharp = {**CORNER, "smoothing": 0.001}
    _, motion = played(follow(tmp_path, sharp), 3.0)
    apart = np.linalg.norm(motion[:, 0] - [0.1, 0.0, 0.0], axis=1).min()
    assert apart == pytest.approx(0.01, abs=1e-4)
    speed, bend = (np.linalg.norm(motion[:, k], axis=1) for k in (1, 2))
    assert speed.max() <= 0.2 * 1.001
    # Time-optimal: wherever it moves, one of the two limits is met.
    moving = speed > 0.01
    met = (speed > 0.2 * 0.99) | (bend > 0.5 * 0.97)
    assert met[moving].mean() > 0.95
    smooth = played(follow(tmp_path, CORNER), 3.0)[1]
    assert np.linalg.norm(smooth[:, 2], axis=1).max() <= 0.5 * 1.01
    assert np.abs(np.diff(smooth[:, 2], axis=0)).max() / 0.001 <= 2.0 * 0.5 / 0.1 * 1.1


def test_a_waypoint_to_stop_at_is_reached(tmp_path: Path) -> None:
    points = [{**CORNER["waypoints"][0], "stop": True}, CORNER["waypoints"][1]]
    _, motion = played(follow(tmp_path, {**CORNER, "waypoints": points}), 4.0)
    nearest = np.linalg.norm(motion[:, 0] - [0.1, 0.0, 0.0], axis=1).argmin()
    assert np.linalg.norm(motion[nearest, 0] - [0.1, 0.0, 0.0]) < 1e-4
    assert np.linalg.norm(motion[nearest, 1]) < 0.01


def test_a_turn_keeps_its_own_limits(tmp_path: Path) -> None:
    turn = {**CORNER, "waypoints": [{"position": [0, 0, 0], "rotation": [0.1, 0.0, 0.0]}]}
    path = follow(tmp_path, turn)
    found = np.array([path.rotation(float(t)) for t in np.arange(0.0, 3.0, 0.001)])
    np.testing.assert_allclose(found[-1, 0], [0.1, 0.0, 0.0], atol=1e-9)
    assert np.linalg.norm(found[:, 1], axis=1).max() <= 0.5 * 1.001
    assert np.linalg.norm(found[:, 2], axis=1).max() <= 2.0 * 1.02


def test_a_table_is_met_at_each_row_and_travels_with_the_scenario(tmp_path: Path) -> None:
    times = np.linspace(0.0, 2.0, 41)
    x = 0.02 * (1.0 - np.cos(np.pi * times))
    half = 0.5 * 0.5 * x  # the tilt about z is half of x
    rows = [
        f"{t},{a},0,0,{math.cos(h)},0,0,{math.sin(h)}"
        for t, a, h in zip(times, x, half, strict=True)
    ]
    file = tmp_path / "motion.csv"
    file.write_text("\n".join(["t,x,y,z,qw,qx,qy,qz", *rows]))
    loaded = scenario(tmp_path, {"kind": "table", "file": "motion.csv"})
    file.unlink()
    again = Scenario.model_validate(yaml.safe_load(yaml.safe_dump(loaded.model_dump(mode="json"))))
    for path in (trajectory(loaded.reference), trajectory(again.reference)):
        for t, a in zip(times, x, strict=True):
            np.testing.assert_allclose(path(float(t))[0], [a, 0.0, 0.0], atol=1e-9)
            np.testing.assert_allclose(path.rotation(float(t))[0][2], 0.5 * a, atol=1e-9)


def test_a_parquet_file_is_the_same_as_a_csv(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow.parquet import write_table

    times = np.linspace(0.0, 2.0, 41)
    columns = {"t": times, "x": 0.0 * times, "y": 0.0 * times, "z": 0.01 * times**2}
    write_table(pyarrow.table(columns), tmp_path / "motion.parquet")
    rows = [",".join(map(repr, map(float, row))) for row in zip(*columns.values(), strict=True)]
    (tmp_path / "motion.csv").write_text("\n".join(["t,x,y,z", *rows]))
    found = [
        scenario(tmp_path, {"kind": "table", "file": f"motion.{kind}"}).reference.prepared.data  # type: ignore[union-attr]
        for kind in ("csv", "parquet")
    ]
    assert found[0] == found[1]


def test_an_object_is_sampled_and_approached(tmp_path: Path) -> None:
    path = follow(tmp_path, OWN)
    np.testing.assert_allclose(path(1.0)[0], [0.0, 0.0, 0.025], atol=1e-8)
    np.testing.assert_allclose(path(9.0)[0], [0.0, 0.0, 0.05], atol=1e-12)


def test_the_angular_velocity_is_that_of_the_rotation() -> None:
    vector, rate, h = np.array([0.3, -0.2, 0.5]), np.array([0.4, 0.1, -0.3]), 1e-6
    before, after = (Rotation.from_rotvec(vector + k * h * rate) for k in (-1, 1))
    expected = (after * before.inv()).as_rotvec() / (2 * h)
    np.testing.assert_allclose(angular_velocity(vector, rate), expected, atol=1e-8)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t,x,y\n0,0,0\n", "has no column z"),
        ("t,x,y,z\n0,0,0,0\n1,0,0\n", "row 2: has 3 values for 4 columns"),
        ("t,x,y,z\n0,0,0,0\n1,0,a,0\n", "row 2: y is 'a', which is no number; correct it"),
        ("t;x;y;z\n0;0,5;0;0\n", "has semicolons between its columns; use commas there"),
        ("t,x,y,z\n0,0,0,0\n0,0,0,0\n", "row 2: t does not increase"),
        ("t,x,y,z\n0,0,0,0\n1,0,nan,0\n", "row 2: y is no number"),
        ("t,x,y,z\n0,0,0,0\n", "has 1 rows"),
        ("t,x,y,z,rx\n0,0,0,0,0\n1,0,0,0,0\n", "has no column ry"),
        ("t,x,y,z,w\n0,0,0,0,0\n1,0,0,0,0\n", "has a column 'w'"),
        ("t,x,y,z\n0,0.1,0,0\n1,0,0,0\n", "the first pose is 0.1"),
        ("", "is empty"),
    ],
)
def test_a_wrong_table_is_one_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "motion.csv").write_text(text)
    with pytest.raises(ConfigError) as error:
        scenario(tmp_path, {"kind": "table", "file": "motion.csv"})
    assert said in str(error.value)
    assert "own.yaml:" in str(error.value)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("tests.unit.own_trajectories:Broken", "gives at 0.510 s no 3 or 6 finite numbers"),
        ("no_such_module:Class", "cannot be imported"),
        ("unregistered", "not installed"),
    ],
)
def test_a_wrong_object_is_one_line(tmp_path: Path, name: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        scenario(tmp_path, {"kind": "object", "name": name, "length": 2.0})


def _table(*rows: tuple[float, ...]) -> str:
    return "\n".join(["t,x,y,z,rx,ry,rz", *(",".join(map(str, row)) for row in rows)])


def _round(radius: float, frequency: float, **more: Any) -> dict[str, Any]:
    return {**CIRCLE, "radius": radius, "frequency": frequency, **more}


def _wave(amplitude: float, frequency: float) -> dict[str, Any]:
    way = {"direction": [0, 0, 1], "amplitude": amplitude, "frequency": frequency}
    return {"kind": "lissajous", "fade": 1.0, "components": [way]}


def _to(*position: float, **more: Any) -> dict[str, Any]:
    return {**CORNER, "waypoints": [{"position": list(position)}], **more}


SPIN = {"axis": [1.0, 0.0, 0.0], "amplitude": 0.3, "frequency": 0.25}
QUICK = {"axis": [0.0, 0.0, 1.0], "amplitude": 0.17, "frequency": 8.0}
IMPOSSIBLE: dict[str, tuple[dict[str, Any], str]] = {
    "circle too large": (_round(0.35, 0.04, fade=10.0), "leaves the workspace"),
    "circle too fast": (_round(0.03, 2.0), "faster than the envelope lets pass"),
    "circle tilted too far": (_round(0.01, 0.1, turns=[SPIN]), "tilts by 10."),
    "figure too high": (_wave(0.25, 0.05), "which ends at z = \\+0.200 m"),
    "figure too quick": (_wave(0.004, 12.0), "faster than the envelope lets pass"),
    "turning too quickly": (_round(0.01, 0.1, turns=[QUICK]), "runs cable|accelerates cable"),
    "waypoint outside": (_to(0.4, 0.0, 0.0), "which ends at x = \\+0.250 m"),
    "waypoints too fast": (_to(0.2, 0.0, 0.0, speed=0.5), "faster than the envelope lets pass"),
    "figure shaking": (_wave(0.0005, 65.0), "accelerates cable"),
    "waypoint tilted": (
        {**CORNER, "waypoints": [{"position": [0, 0, 0], "rotation": [0, 0.25, 0]}]},
        "more than robot.workspace.tilt_deg",
    ),
    "table outside": ({"kind": "table", "file": "far.csv"}, "which ends at y = -0.250 m"),
    "object too high": (
        {**OWN, "settings": {"height": 0.5, "length": 8.0}, "length": 8.0},
        "which ends at z = \\+0.200 m",
    ),
    "object too fast": (
        {**OWN, "settings": {"height": 0.15, "length": 0.5}, "length": 0.5},
        "faster than the envelope lets pass",
    ),
}


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_an_impossible_trajectory_is_refused_with_its_first_point(
    tmp_path: Path, name: str
) -> None:
    reference, said = IMPOSSIBLE[name]
    rows = [(t, 0.0, -0.15 * t, 0.0, 0.0, 0.0, 0.0) for t in (0.0, 1.0, 2.0, 3.0)]
    (tmp_path / "far.csv").write_text(_table(*rows))
    config, _ = load("config/can.yaml")
    finding = next(
        each
        for each in scenario_rules(config, scenario(tmp_path, reference))
        if each.rule == "reference"
    )
    assert not finding.ok
    assert re.search(said, finding.text), finding.text
    assert re.search(r"first at \d+\.\d{3} s at \([+-]", finding.text)


def test_the_largest_excess_is_named_too(tmp_path: Path) -> None:
    config, _ = load("config/can.yaml")
    far = scenario(tmp_path, _to(0.4, 0.0, 0.0))
    text = next(each.text for each in scenario_rules(config, far) if each.rule == "reference")
    found = re.search(r"by (\S+) mm, first at (\S+) s at .*; most at (\S+) s, by 150.0 mm", text)
    assert found, text
    excess, first, most = map(float, found.groups())
    assert excess < 2.0
    assert first < most


def test_weak_cables_are_the_reason_that_is_named(tmp_path: Path) -> None:
    strict = {"control.tension.max": 47.0, "control.tension.min": 43.0}
    config, _ = load("config/can.yaml", overrides=strict)
    hard = scenario(tmp_path, _to(0.1, 0.0, 0.0, acceleration=20.0, smoothing=0.01))
    finding = next(each for each in scenario_rules(config, hard) if each.rule == "reference")
    assert "for which tensions must leave 43 to 47 N by" in finding.text


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_one_is_accepted(name: str) -> None:
    config, loaded = load("config/can.yaml", name)
    assert all(finding.ok for finding in scenario_rules(config, loaded))
