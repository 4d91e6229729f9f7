"""`tonus check`: the shipped configuration passes, and each rule can fail."""

from __future__ import annotations

import json
import re
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import linprog

import tonus.tools.check.rules
import tonus.tools.margins.tension_loop
from tonus.config import Config, ConfigError, Scenario, load
from tonus.config.loader import HERE, load_catalogue, load_plausible, load_scenario
from tonus.config.schema.bus import CanopenBus
from tonus.config.schema.plausible import Bound
from tonus.config.timeouts import master_timeout_ms
from tonus.tools.check.controller import check_controller
from tonus.tools.check.feasibility import (
    Poses,
    against,
    feasibility,
    poses,
    reserves,
    workspace_poses,
)
from tonus.tools.check.mechanics import DIRECTIONS
from tonus.tools.check.plausibility import plausibility
from tonus.tools.check.rules import Finding, check, check_parts
from tonus.tools.cli.check import check as command
from tonus.tools.margins.tension_loop import tension_loop_margins

CONFIG, SCENARIO = load("config/can.yaml", scenario="load_test")
WEIGHT = CONFIG.robot.platform.mass * CONFIG.robot.gravity


MARGINS = lru_cache(tension_loop_margins)
JUDGED: dict[object, list[Finding]] = {}


def judged(config: Config, *, timed: bool = False) -> list[Finding]:
    """`check_controller`, once for all that it reads of a configuration."""
    dumped = config.robot.model_dump_json() + config.control.model_dump_json()
    key = (dumped, config.response, timed)
    if key not in JUDGED:
        JUDGED[key] = list(check_controller(config, timed=timed))
    return JUDGED[key]


@pytest.fixture(autouse=True)
def _margins_of_one_loop_are_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are most of a check's time, and few of these tests change the loop."""
    monkeypatch.setattr(tonus.tools.margins.tension_loop, "tension_loop_margins", MARGINS)
    monkeypatch.setattr(tonus.tools.check.rules, "check_controller", judged)


def failed(overrides: dict[str, Any], scenario: Scenario = SCENARIO) -> dict[str, Finding]:
    config, _ = load("config/can.yaml", overrides=overrides)
    return {each.rule: each for each in check(config, scenario) if not each.ok}


def only(found: dict[str, Finding], rule: str) -> Finding:
    assert list(found) == [rule]
    return found[rule]


@pytest.mark.parametrize(
    "name",
    ["can", "direct", "ethercat", "mixed", "robot", "seven", "six", "twelve", "unlike_axes"],
)
def test_what_is_shipped_passes(name: str) -> None:
    config, scenario = load(f"config/{name}.yaml")
    findings = check(config, scenario)
    assert [finding for finding in findings if not finding.ok] == []
    assert {each.rule for each in check_parts(config, scenario)} < {each.rule for each in findings}


@pytest.mark.parametrize("name", sorted(file.stem for file in (HERE / "scenarios").glob("*.yaml")))
def test_every_scenario_that_is_shipped_passes(name: str) -> None:
    assert failed({}, load_scenario(name)) == {}


def one_channel(period_us: int) -> list[Finding]:
    bus = CONFIG.fieldbus
    assert isinstance(bus, CanopenBus)
    channel = {
        "name": "can0",
        "drives": [d.model_dump() for c in bus.channels for d in c.drives],
        "force_cells": [c.model_dump() for channel in bus.channels for c in channel.force_cells],
    }
    config, _ = load(
        "config/can.yaml",
        overrides={"fieldbus.channels": [channel], "control.rates.period_us": period_us},
    )
    return [finding for finding in check(config, SCENARIO) if finding.rule == "bus load"]


def test_everything_on_one_channel_is_refused_at_1_khz_and_not_at_250_hz() -> None:
    (fast,) = one_channel(1000)
    assert not fast.ok
    assert fast.text.startswith(
        "channel can0 carries 2750 us of frames in a cycle of 1000 us (275.0 %"
    )
    assert fast.text.endswith("the limit is 85 %")
    assert fast.remedy == "use more channels or a longer period"
    (slow,) = one_channel(4000)
    assert slow.ok


def test_two_nodes_with_one_id_are_named_and_so_is_their_cob_id() -> None:
    found = failed({"fieldbus.channels.0.force_cells.1.node_id": 1})
    assert found["node ids"].text == "axis 0 and cell 6 both have node id 1"
    assert found["COB-IDs"].text == "axis 0 and cell 6 both use COB-ID 0x081"
    assert found["node ids"].where == "fieldbus.channels can0"


def test_no_node_may_have_the_masters_id() -> None:
    found = failed({"fieldbus.channels.2.drives.0.node_id": 127})
    assert found["node ids"].text == "the master and axis 3 both have node id 127"
    assert found["COB-IDs"].text == "the master and axis 3 both use COB-ID 0x77F"


def test_one_id_on_two_channels_is_no_collision() -> None:
    assert failed({"fieldbus.channels.1.drives.0.node_id": 1}) == {}


@pytest.mark.parametrize(
    ("overrides", "rule", "said"),
    [
        ({"fieldbus.drive.master_timeout_ms": 99}, "heartbeat", "wait 99 ms"),
        ({"fieldbus.master.heartbeat_periods": 2}, "heartbeat", "200 ms for a node's heartbeat"),
        ({"tolerance.jitter_ms": 19}, "jitter", "19 ms late, drives and ticks need 20 ms"),
        ({"tolerance.lost.pdo": 3}, "lost frames", "1 SYNCs, 3 PDOs lost in a row"),
        ({"tolerance.lost.sync": 3}, "lost frames", "and 1 ticks of delay, need 4"),
        ({"control.freshness.measurement_ticks": 1}, "lost frames", "usable for 1 ticks"),
        ({"control.freshness.stale_stop_ticks": 2}, "lost frames", "stops after 2 ticks"),
        ({"fieldbus.drive.interpolation_ms": 1}, "interpolation", "one lost set-point"),
        ({"tracker.maximum_age_ms": 80.0}, "tracker", "a pose counts for 80 ms"),
        ({"tracker.rate_hz": 40.0}, "tracker", "19 come in 0.5 s"),
        ({"control.rates.period_us": 1500}, "period", "13.3333 cycles"),
        ({"fieldbus.channels.1.name": "can0"}, "channel names", "can0 is given twice"),
        ({"fieldbus.drive.rpdo": [0x60400010]}, "PDO mapping", "0x6071:0"),
        ({"fieldbus.drive.rpdo": [0x60400010, 0x60710010, 0x60FF0020]}, "PDO mapping", "60FF"),
        ({"fieldbus.drive.tpdo": [0x60410010, 0x60770010]}, "PDO mapping", "0x6064:0"),
        ({"fieldbus.drive.tpdo": [0x60410010, 0x60640018, 0x60770010]}, "PDO mapping", "24 bits"),
        ({"fieldbus.force_cell.tpdo": [0x61500108]}, "PDO mapping", "no process value"),
        ({"fieldbus.load_limit": 0.72}, "bus load", "can3 carries 800 us"),
        ({"robot.home": [0.0, 0.0, 0.3]}, "places", "outside the workspace"),
        ({"robot.rest": [0.0, 0.4, 0.0]}, "places", "outside the workspace"),
        ({"robot.motor.current_limit": 5.7}, "motor torque", "200 N need 5.75 A of 5.7 A"),
        ({"control.envelope.speed_limit": 0.6}, "motor speed", "0.516 m/s"),
        (
            {"robot.axes": {3: {"motor": {"current_limit": 5.0}}, 6: {"sign": -1}}},
            "motor torque",
            "200 N need 5.75 A of 5 A on axis 3",
        ),
        (
            {"robot.axes": {axis: {"motor": {"nominal_speed_rpm": 1400}} for axis in (1, 2)}},
            "motor speed",
            "0.239 m/s on axes 1, 2,",
        ),
        (
            {"robot.axes": {7: {"drum": {"inertia": 1.0e-3}}}},
            "drum damping",
            "less than 833 N s/m on axis 7",
        ),
        (
            {"robot.axes": {5: {"cable": {"axial_stiffness": 30000.0}}}},
            "tension loop",
            "on axis 5 over cables of",
        ),
        (
            {"robot.axes": {5: {"cable": {"axial_stiffness": 30000.0}}}},
            "margins",
            "on axis 5",
        ),
        ({"control.stop.passive_damping": 3600.0}, "drum damping", "3600 N s/m"),
        ({"control.stop.reel_damping": 3500.0}, "drum damping", "less than 3500 N s/m"),
        ({"control.tension_loop.rate_damping": 0.1}, "tension loop", "floors 6 dB and 35 deg"),
        ({"control.tension_loop.proportional": 60.0}, "tension loop", "floors 6 dB and 35 deg"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_each_rule_can_fail(overrides: dict[str, Any], rule: str, said: str) -> None:
    found = failed(overrides)
    assert rule in found
    assert said in found[rule].text
    assert found[rule].remedy
    assert found[rule].where


def test_a_timeout_that_is_stated_may_be_as_short_as_losses_and_jitter_allow() -> None:
    assert failed({"fieldbus.drive.master_timeout_ms": 100}) == {}
    quick = {"tolerance.jitter_ms": 20}
    assert failed(quick | {"fieldbus.drive.master_timeout_ms": 60}) == {}
    assert "heartbeat" in failed(quick | {"fieldbus.drive.master_timeout_ms": 59})


def test_what_could_stop_the_robot_by_one_lost_frame_was_shipped_once() -> None:
    """Consumers that wait for exactly two periods of their producer."""
    found = failed({"fieldbus.master.heartbeat_ms": 50, "fieldbus.drive.master_timeout_ms": 100})
    assert only(found, "heartbeat").remedy == "leave it out, or set it to at least 160"


@pytest.mark.parametrize("kind", ["heartbeat", "sync", "pdo", "ethercat", "tracker"])
def test_at_least_one_lost_frame_of_each_kind_is_tolerated(kind: str) -> None:
    with pytest.raises(ConfigError, match=f"tolerance.lost.{kind}.*greater than or equal to 1"):
        load("config/can.yaml", overrides={f"tolerance.lost.{kind}": 0})


def test_a_robot_without_a_lab_waits_no_longer_than_it_must() -> None:
    robot, _ = load("config/robot.yaml")
    assert isinstance(robot.fieldbus, CanopenBus)
    assert isinstance(CONFIG.fieldbus, CanopenBus)
    assert master_timeout_ms(robot.fieldbus, robot.fieldbus.drive, robot.tolerance) == 2 * 20 + 20
    assert (
        master_timeout_ms(CONFIG.fieldbus, CONFIG.fieldbus.drive, CONFIG.tolerance) == 2 * 20 + 60
    )


def with_load(force: float, direction: tuple[float, float, float] = (1, 0, 0)) -> Scenario:
    lab = SCENARIO.lab
    assert lab.load is not None
    profile = tuple(point.model_copy(update={"force": force}) for point in lab.load.profile)
    load = lab.load.model_copy(update={"profile": profile, "direction": direction})
    return SCENARIO.model_copy(update={"lab": lab.model_copy(update={"load": load})})


@pytest.mark.parametrize("force", [400.0, -400.0])
def test_a_load_beyond_the_cables_is_refused(force: float) -> None:
    found = only(failed({}, with_load(force)), "load")
    assert "400 N" in found.text
    assert "tensions must leave 20.25 to 200 N" in found.text


def test_a_load_is_judged_where_the_reference_leads() -> None:
    """120 N downwards can be held at home, not under the ceiling, where the cables run flat."""
    waypoint = {"position": (-0.24, -0.24, 0.19), "duration": 5.0}
    reference = {"kind": "path", "waypoints": [waypoint]}
    data = with_load(120.0, (0, 0, -1)).model_dump()
    assert failed({}, Scenario.model_validate(data)) == {}
    away = Scenario.model_validate({**data, "reference": reference})
    assert "load" in failed({}, away)


def test_a_reference_that_leaves_the_workspace_is_refused() -> None:
    data = SCENARIO.model_dump()
    data["lab"]["load"] = None
    data["reference"] = {
        "kind": "sine", "direction": (0, 0, 1), "amplitude": 0.21, "frequency": 0.1, "fade": 0.0,
    }  # fmt: skip
    found = only(failed({}, Scenario.model_validate(data)), "reference")
    assert "leaves the workspace" in found.text


def test_a_fault_needs_its_node() -> None:
    data = SCENARIO.model_dump()
    fault = {"at": 1.0, "kind": "unplug", "channel": "can0", "node": 3}
    data["lab"]["faults"] = [fault, {**fault, "channel": "can1"}]
    found = only(failed({}, Scenario.model_validate(data)), "faults")
    assert found.where.endswith("lab.faults.0")


def test_a_robot_that_cannot_be_balanced_is_refused_with_pose_and_wrench() -> None:
    """All anchors above: nothing pulls the light platform down against 25 N from below."""
    raised = [(x, y, abs(z)) for x, y, z in CONFIG.robot.geometry.frame]
    found = failed({"robot.geometry.frame": raised, "control.tension.min": 5.5}, SCENARIO)
    text = found["workspace"].text
    place, wrench = r"at \([-+\d., ]+\) m", r"to exert \([-+\d., ]+\) N, \([-+\d., ]+\) N m"
    assert re.search(f"{place}.* {wrench}$", text), text


def test_weaker_cables_fail_with_share_and_worst_pose() -> None:
    found = only(failed({"control.tension.max": 120.0}), "workspace")
    assert "gravity and 25 N" in found.text
    share = float(found.text.split(": ")[1].split(" %")[0])
    assert 0.0 < share < 100.0
    assert "+0.200) m" in found.text


def stability(name: str, overrides: dict[str, Any] | None = None) -> list[Finding]:
    config, _ = load(f"config/{name}.yaml", overrides=overrides)
    rules = ("tension loop", "margins")
    return [each for each in check(config, SCENARIO) if each.rule in rules]


@pytest.mark.parametrize(("cutoff", "ok"), [(None, True), (30.0, False)])
def test_the_margins_of_an_observer_are_judged_too(cutoff: float | None, *, ok: bool) -> None:
    overrides: dict[str, Any] = {"control.controller": "bio_observer"}
    if cutoff is not None:
        overrides["control.bio_observer.cutoff_hz"] = cutoff
    config, scenario = load("config/can.yaml", overrides=overrides)
    told = [each for each in check(config, scenario) if each.rule == "margins"]
    assert [each.ok for each in told] == [True, True, ok]
    start = (
        "the observer of bio_observer, cut at the load, mass 20 %, EA 6 % and damping 25 % off: "
    )
    assert told[2].text.startswith(start + ("10.1 dB" if ok else "3.2 dB"))


def test_a_robot_without_a_lab_has_its_margins_judged_as_well() -> None:
    """Its drives and cells are given as fast as the lab's, so that the figures are the same."""
    found = stability("robot")
    assert len(found) == 3
    assert all(each.ok for each in found)
    assert [each.text for each in found] == [each.text for each in stability("can")]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("control.tension_loop.rate_damping", 0.1),
        ("control.tension_loop.proportional", 60.0),
        ("robot.response.current_loop_hz", 60.0),
        ("robot.response.force_cell_hz", 20.0),
    ],
)
def test_margins_that_a_robot_lacks_are_refused(key: str, value: float) -> None:
    assert any(not each.ok for each in stability("robot", {key: value}))


def test_in_a_lab_its_own_drives_and_cells_decide() -> None:
    slow = {"lab.plant.current_loop_hz": 60.0}
    assert any(not each.ok for each in stability("can", slow))
    assert all(each.ok for each in stability("can", {"robot.response.current_loop_hz": 60.0}))


def bounded(maximum: float) -> Any:
    return CONFIG.control.tension.model_copy(update={"max": maximum})


def grid(config: Config = CONFIG) -> Poses:
    box = config.robot.workspace.model_copy(update={"tilt_deg": 0.0})
    return workspace_poses(config.robot.geometry, box, 7)


@pytest.mark.parametrize(
    ("maximum", "force", "percent"),
    [
        (120.0, 0.0, 100.0), (120.0, 25.0, 95.9), (120.0, 100.0, 34.7),
        (150.0, 25.0, 100.0), (150.0, 100.0, 69.7), (180.0, 100.0, 87.8),
        (200.0, 0.0, 100.0), (200.0, 25.0, 100.0), (200.0, 100.0, 93.6),
        (250.0, 100.0, 100.0),
    ],
)  # fmt: skip
def test_the_map_of_the_geometry_is_reproduced(
    maximum: float, force: float, percent: float
) -> None:
    wrenches = against(WEIGHT, force * DIRECTIONS)
    outcome = feasibility(grid(), wrenches, bounded(maximum), 0.1)
    assert 100.0 * outcome.share == pytest.approx(percent, abs=0.05)


def test_the_reserve_is_the_optimum_of_the_linear_programme() -> None:
    """The largest d such that tensions in [min + d, max - d] balance the wrench."""
    at = workspace_poses(CONFIG.robot.geometry, CONFIG.robot.workspace, 3)
    random = np.random.default_rng(5)
    bounds = CONFIG.control.tension
    for index in (0, 13, *random.integers(0, len(at.positions), 25)):
        wrench = 90.0 * random.standard_normal(6) * [1.0, 1.0, 1.0, 0.1, 0.1, 0.1]
        pose = poses(CONFIG.robot.geometry, at.positions[[index]], at.rotations[[index]])
        found = float(reserves(pose, wrench[None], bounds, 0.1)[0, 0])
        ones, eye = np.ones((8, 1)), np.eye(8)
        best = linprog(
            np.array([0.0] * 8 + [-1.0]),
            A_ub=np.vstack([np.hstack([-eye, ones]), np.hstack([eye, ones])]),
            b_ub=np.array([-bounds.min] * 8 + [bounds.max] * 8),
            A_eq=np.hstack([pose.matrices[0], np.zeros((6, 1))]),
            b_eq=wrench,
            bounds=[(None, None)] * 9,
        )
        assert found == pytest.approx(-best.fun, abs=1e-6)


def test_where_the_cables_lose_a_degree_of_freedom_nothing_is_feasible() -> None:
    geometry = CONFIG.robot.geometry.model_copy(update={"platform": ((0.0, 0.0, 0.0),) * 8})
    at = poses(geometry, np.zeros((1, 3)), np.zeros((1, 3)))
    outcome = feasibility(at, against(WEIGHT, 0.0 * DIRECTIONS), CONFIG.control.tension, 0.1)
    assert outcome.share == 0.0
    assert outcome.reserve == -np.inf


def test_the_command_prints_a_table_and_says_whether_all_is_well() -> None:
    result = CliRunner().invoke(command, ["config/can.yaml"])
    assert result.exit_code == 0
    assert "channel can3 carries 800 us of frames" in result.output
    assert result.output.splitlines()[-1].endswith("checks passed")
    listed = CliRunner().invoke(command, ["config/can.yaml", "--json", "--scenario", "hold"])
    assert listed.exit_code == 0
    findings = json.loads(listed.output)
    assert all(finding["ok"] for finding in findings)
    assert set(findings[0]) == {"rule", "ok", "where", "text", "remedy"}


def test_the_command_exits_with_1_when_a_check_failed(tmp_path: Any) -> None:
    data = (HERE / "can.yaml").read_text(encoding="utf-8")
    path = tmp_path / "mine.yaml"
    data = data.replace("!include ", f"!include {HERE}/")
    path.write_text(data.replace("can4.yaml", "can1.yaml"), encoding="utf-8")
    result = CliRunner().invoke(command, [str(path)])
    assert result.exit_code == 1
    assert "FAILED  bus load      channel can0 carries 2750 us" in result.output
    assert "use more channels or a longer period" in result.output
    assert "1 of " in result.output.splitlines()[-1]


def test_anchors_in_millimetres_are_named_with_the_remedy_and_nothing_else_is_computed() -> None:
    frame = [[1000.0 * each for each in point] for point in CONFIG.robot.geometry.frame]
    finding = only(failed({"robot.geometry.frame": frame}), "units")
    assert finding.where == "robot.geometry.frame"
    assert "it looks like mm" in finding.text
    assert "give it in m" in finding.remedy


def test_an_axis_own_value_in_millimetres_is_named_at_its_place() -> None:
    finding = only(failed({"robot.axes": {4: {"drum": {"radius": 25.0}}}}), "units")
    assert finding.where == "robot.axes.4.drum.radius"
    assert "it looks like mm" in finding.text


@pytest.mark.parametrize(
    "bound",
    # The schema holds the tensions against each other.
    [each for each in load_plausible().bounds if each.key != "control.tension.max"],
    ids=lambda bound: bound.key,
)
def test_each_value_in_its_usual_wrong_unit_is_seen(bound: Bound) -> None:
    def scaled(value: Any) -> Any:
        return value * bound.factor if isinstance(value, float) else [scaled(v) for v in value]

    value: Any = CONFIG
    for part in bound.key.split("."):
        value = getattr(value, part)
    overrides = {bound.key: scaled(value)}
    config, _ = load("config/can.yaml", overrides=overrides)
    (finding,) = (each for each in plausibility(config) if not each.ok)
    assert finding.where == bound.key
    assert bound.mistaken in finding.text


def test_a_load_that_comes_before_the_robot_is_ready_is_refused() -> None:
    """With a slow referencing it would be over before the test begins."""
    found = failed({"control.sequence.referencing_settle_s": 8.0})
    finding = only(found, "load")
    assert "begins 6 s after the drives are enabled, ACTIVE 11.1 s" in finding.text
    assert "let it begin at 11.6 s or later" in finding.remedy
    assert failed({"control.sequence.referencing_settle_s": 8.0}, load_scenario("hold")) == {}


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A configuration elsewhere, with a scenario beside it and one in a folder of its own."""
    text = "\n".join(
        line.replace("!include ", f"!include {HERE}/")
        for line in (HERE / "direct.yaml").read_text().splitlines()
        if not line.startswith(("scenario:", "operation:"))
    )
    (tmp_path / "operation").mkdir()
    still = (HERE / "scenarios/hold.yaml").read_text().replace("name: hold", "name: still")
    (tmp_path / "still.yaml").write_text(still)
    far = (HERE / "scenarios/sine_x.yaml").read_text().replace("name: sine_x", "name: far")
    far = re.sub(r"amplitude: [0-9.e-]+", "amplitude: 3.0", far)
    (tmp_path / "operation/far.yaml").write_text(far)
    (tmp_path / "operation/scenes.yaml").write_text("scenarios: [far.yaml, ../still, sine_z]\n")
    extra = "\nscenario: still.yaml\noperation: !include operation/scenes.yaml\n"
    (tmp_path / "own.yaml").write_text(text + extra)
    return tmp_path / "own.yaml"


def test_names_in_a_file_start_from_that_file_wherever_one_is(
    own: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert load(own)[1].name == "still"
    assert [each.name for each in load_catalogue(own)] == ["far", "still", "sine_z"]
    monkeypatch.chdir(tmp_path)
    for given in ("still.yaml", "still", "operation/far", "./still"):
        assert load_scenario(given).name in given
    assert load_scenario("hold").name == "hold", "what is shipped needs no path"


def test_what_an_operator_may_choose_is_checked(own: Path) -> None:
    result = CliRunner().invoke(command, [str(own)])
    assert result.exit_code == 1, result.output
    assert "far moves at" in result.output
    assert "sine_z may be chosen" in result.output
    (own.parent / "operation/far.yaml").unlink()
    missing = CliRunner().invoke(command, [str(own)]).exception
    assert isinstance(missing, ConfigError)
    assert "scenes.yaml:1" in str(missing)


def test_cables_that_lift_the_platform_out_of_its_cradle_while_referencing_are_refused() -> None:
    """On the suspended robot every cable pulls up: 117.7 N of weight against 2.85 N of lift for
    each newton of even tension."""
    overrides = {"control.tension.referencing": 42.0, "control.tension.pre": 45.0}
    config, scenario = load("config/six.yaml", overrides=overrides)
    found = {each.rule: each for each in check(config, scenario) if not each.ok}
    assert "referencing" in found
    assert "42 N in every cable lift with 119" in found["referencing"].text
    assert found["referencing"].where == "control.tension.referencing"


def test_an_inertia_that_no_such_platform_has_is_seen() -> None:
    """In kg cm2: 2.35 kg as far out as twice its anchors have 0.31 kg m2."""
    found = failed({"robot.platform.inertia": [255.0, 255.0, 353.0]})
    assert "353 kg m2, and 2.35 kg within 0.36 m have 0.31" in only(found, "units").text


def test_a_workspace_without_a_turn_is_plausible() -> None:
    config, _ = load("config/can.yaml", overrides={"robot.workspace.tilt_deg": 0.0})
    assert all(each.ok for each in plausibility(config))


def test_a_channel_that_two_parts_of_the_fieldbus_name() -> None:
    bus = load("config/can.yaml")[0].fieldbus.model_dump(mode="json")
    channels = bus.pop("channels")
    parts = [{**bus, "channels": some} for some in (channels[:2], channels[2:])]
    whole = {"fieldbus": {"kind": "several", "buses": parts}}
    assert not [each for each in check(*load("config/can.yaml", overrides=whole)) if not each.ok]
    channels[3]["name"] = "can0"
    found = [each for each in check(*load("config/can.yaml", overrides=whole)) if not each.ok]
    assert {each.text for each in found if each.rule == "channel names"} == {"can0 is given twice"}
