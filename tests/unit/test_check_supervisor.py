"""What `tonus check` and the loader refuse: a supervisor that could not stop the robot in time."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest

from tonus.config import Config, ConfigError, load
from tonus.config.schema.bus import CanopenBus
from tonus.runtime.control.filters import ButterworthBank
from tonus.tools.check.finding import Finding
from tonus.tools.check.plausibility import plausibility
from tonus.tools.check.rules import check_parts
from tonus.tools.check.supervisor import _ramp_of, check_supervisor
from tonus.tools.errors import ToolError
from tonus.tools.run.supervision import require_reach, wanted

ROBOT: dict[str, Any] = {"lab": None}
_ABORT = "options.abort_connection"


def findings(config: Config, scenario: Any) -> list[Finding]:
    assert all(each.ok for each in plausibility(config))
    found = check_parts(config, scenario)
    return [each for each in found if each.rule == "supervisor" and not each.ok]


def refused(path: str, **overrides: Any) -> list[Finding]:
    stated = {key.replace("__", "."): value for key, value in overrides.items()}
    return findings(*load(path, overrides=stated))


@pytest.mark.parametrize("name", ["can", "mixed", "mixed_drives"])
def test_a_lab_needs_no_supervisor_that_can_stop_it(name: str) -> None:
    assert refused(f"config/{name}.yaml") == []


def test_a_robot_without_a_supervisor() -> None:
    found = refused("config/can.yaml", lab=None, supervisor=None)
    assert [each.where for each in found] == ["supervisor"]
    off = {"lab": None, "supervisor__policy": "off"}
    assert len(refused("config/can.yaml", **off)) == 1
    assert refused("config/can.yaml", **off, relaxed=["supervisor.policy"]) == []


def test_a_robot_whose_drives_do_not_watch_it() -> None:
    found = refused("config/mixed_drives.yaml", lab=None)
    assert found
    assert all("no second heartbeat consumer" in each.text for each in found)
    assert all(each.where.endswith("watches_supervisor") for each in found)


@pytest.mark.parametrize("name", ["mixed", "mixed_drives_ethercat", "direct"])
def test_a_robot_with_drives_that_are_not_on_can(name: str) -> None:
    path = f"config/{name}.yaml"
    found = refused(path, lab=None)
    assert [each.where for each in found] == ["supervisor.policy"]
    assert "cannot stop axes 0, 1, 2, 3, 4, 5, 6, 7" in found[0].text
    off = {"lab": None, "supervisor__policy": "off"}
    assert [each.where for each in refused(path, **off)] == ["supervisor"]
    assert refused(path, **off, relaxed=["supervisor.policy"]) == []
    assert not wanted(load(path)[0]), "it would send a heartbeat and judge nothing"


def test_a_robot_whose_load_cells_are_not_on_can_beside_drives_that_are() -> None:
    def found(path: str, wanted: int, **overrides: Any) -> list[Finding]:
        config, _ = load(path, overrides=overrides)
        bus = config.fieldbus
        assert isinstance(bus, CanopenBus)
        channels = [each.model_copy(update={"force_cells": ()}) for each in bus.channels[-wanted:]]
        update = {"channels": (*bus.channels[:-wanted], *channels)}
        without = config.model_copy(update={"fieldbus": bus.model_copy(update=update)})
        return [each for each in check_supervisor(without) if not each.ok]

    assert found("config/can.yaml", 1) == [], "in a lab"
    robot = found("config/can.yaml", 1, lab=None)
    assert [each.where for each in robot] == ["supervisor.policy"]
    assert "does not read load cells 1, 7, 8" in robot[0].text
    use = {"lab": None, "supervisor.policy": "use", "relaxed": ["supervisor.policy"]}
    assert found("config/can.yaml", 1, **use) == []


@pytest.mark.parametrize(
    ("key", "most"),
    [("control.sequence.tare_limit", 7.5), ("control.stiffness.rise_rate", 44592.0)],
)
def test_bounds_of_control_that_it_judges_by(key: str, most: float) -> None:
    for value, count in ((most * 1.001, 1), (most * 0.999, 0)):
        given = {key.replace(".", "__"): value}
        assert refused("config/can.yaml", **given) == []
        found = refused("config/can.yaml", lab=None, **given)
        assert [each.where for each in found] == [key] * count


@pytest.mark.parametrize(("key", "most"), [("opposed_error", 4.0), ("logged_tension", 20.0)])
def test_bounds_of_a_robot_with_smaller_tensions(key: str, most: float) -> None:
    for value, there in ((most + 0.1, True), (most, False)):
        given = {"control__tension__pre": 40.0, f"supervisor__{key}": value}
        found = refused("config/can.yaml", lab=None, **given)
        assert (f"supervisor.{key}" in [each.where for each in found]) is there


def test_a_silence_that_no_drive_would_notice() -> None:
    stated = {"supervisor.timeout_ms": 60, "supervisor.quiet_s": 0.12}
    load("config/can.yaml", overrides=stated)
    with pytest.raises(ConfigError, match=r"quiet_s is 0\.119: .* set it to at least 0\.12"):
        load("config/can.yaml", overrides=stated | {"supervisor.quiet_s": 0.119})


def test_a_run_that_requires_one_that_has_no_drive_to_act_on() -> None:
    for stated, refuses in (({}, False), ({"supervisor.policy": "require"}, True)):
        config, _ = load("config/mixed.yaml", overrides=stated)
        with pytest.raises(ToolError, match="no drive is on CAN") if refuses else nullcontext():
            require_reach(config)
    config, _ = load("config/can.yaml", overrides={"supervisor.policy": "require"})
    require_reach(config)
    assert wanted(config)
    assert not wanted(load("config/can.yaml", overrides={"supervisor.policy": "off"})[0])


@pytest.mark.parametrize(
    ("key", "most"),
    [
        ("tension_stopping", 300.0),
        ("contact_stopping", 37.5),
        ("contact_at_once", 75.0),
        ("opposed_long_force", 22.5),
        ("opposed_long_error", 11.25),
        ("excess_force", 360.0),
        ("passive_torque", 11.25),
        ("speed_stopping", 2.5),
        ("speed_on_path", 0.75),
        ("speed_in_descent", 1.0),
        ("unexplained_force", 90.0),
        ("opposed_force", 67.5),
        ("answered_torque", 22.5),
    ],
)
def test_bounds_that_are_far_beyond_the_envelope(key: str, most: float) -> None:
    beyond = {f"supervisor__{key}": most + 0.1}
    assert refused("config/can.yaml", **beyond) == []
    found = refused("config/can.yaml", lab=None, **beyond)
    assert [each.where for each in found] == [f"supervisor.{key}"]
    assert refused("config/can.yaml", lab=None, **{f"supervisor__{key}": most}) == []


@pytest.mark.parametrize(
    ("key", "most"),
    [
        ("control__stop__passive_tension", 22.8),
        ("control__isolation__tension_error", 22.5),
        ("control__isolation__tension_error_s", 0.25),
        ("control__envelope__over_tension_ticks", 5),
        ("control__tension__slack", 2.41),
        ("supervisor__stop_s", 80.0),
        ("supervisor__frozen_rate", 0.06),
        ("supervisor__frozen_tension", 0.1),
        ("supervisor__rotation_stopping", 20.0),
        ("supervisor__margin", 1.2),
        ("robot__response__force_cell_hz", 31.84),
    ],
)
def test_keys_with_which_a_requirement_would_never_say_anything(key: str, most: float) -> None:
    below = key.endswith(("slack", "force_cell_hz"))
    more = most - 0.02 if below else most + (1 if isinstance(most, int) else 0.01)
    named = key.replace("__", ".")
    assert named not in [each.where for each in refused("config/can.yaml", **{key: more})]
    assert named in [each.where for each in refused("config/can.yaml", lab=None, **{key: more})]
    assert named not in [each.where for each in refused("config/can.yaml", lab=None, **{key: most})]


@pytest.mark.parametrize(("period_us", "share"), [(500, 1), (1000, 1), (2000, 2), (3000, 3)])
def test_frames_and_ticks_that_are_longer_than_a_millisecond(period_us: int, share: int) -> None:
    given = {"lab": None, "control__rates__period_us": period_us}
    for key, most in (("frozen_frames", 20 // share), ("logged_ticks", 16 // share)):
        for value, there in ((most + 1, True), (most, False)):
            found = refused("config/can.yaml", **given, **{f"supervisor__{key}": value})
            assert (f"supervisor.{key}" in [each.where for each in found]) is there


@pytest.mark.parametrize(
    ("patience_ms", "logged", "least_hz"),
    [(5.0, 15.0, 42.3), (10.0, 15.0, 21.15), (5.0, 20.0, 29.9)],
)
def test_a_filter_that_records_a_contact_too_late(
    patience_ms: float, logged: float, least_hz: float
) -> None:
    """Against the daemon's own filter: how long a contact of 27.5 N at once is recorded as less by
    more than SUP-11 allows."""
    for hertz in (0.95 * least_hz, 1.05 * least_hz):
        bank = ButterworthBank(1, hertz, 1e5)
        bank.reset(np.zeros(1))
        steps = range(round(patience_ms * 100.0))
        late = bool(27.5 - [bank.step(np.array([27.5]))[0] for _ in steps][-1] > logged)
        given = {
            "control__filters__force_cutoff_hz": hertz,
            "supervisor__patience_ms": patience_ms,
            "supervisor__logged_tension": logged,
        }
        assert "control.filters.force_cutoff_hz" not in {
            each.where for each in refused("config/can.yaml", **given)
        }
        found = refused("config/can.yaml", lab=None, **given)
        assert ("control.filters.force_cutoff_hz" in {each.where for each in found}) is late
        assert late is (hertz < least_hz)


def test_a_robot_whose_cables_carry_more() -> None:
    """What the widest bound of tension may be follows from that, in a lab too."""
    for most, tension, fine in ((200.0, 2000.0, True), (200.0, 2000.1, False), (201.0, 2001, True)):
        given = {"control.tension.max": most, "supervisor.tension_stopping": tension}
        with nullcontext() if fine else pytest.raises(ConfigError, match="at most 2000"):
            load("config/can.yaml", overrides=given)


def test_poses_that_a_small_robot_does_not_have() -> None:
    config, _ = load("config/can.yaml", overrides={"lab": None})
    frame = [[0.3 * each for each in anchor] for anchor in config.robot.geometry.frame]
    given: dict[str, Any] = {"robot.geometry.frame": frame, "lab": None}
    small, _ = load("config/can.yaml", overrides=given)
    found = [each for each in check_supervisor(small) if not each.ok]
    assert [each.where for each in found] == ["supervisor.spread"]
    given["supervisor.spread"] = 0.4 * 0.5 * min(np.ptp(np.array(frame), axis=0).tolist())
    small, _ = load("config/can.yaml", overrides=given)
    assert all(each.ok for each in check_supervisor(small))


@pytest.mark.parametrize(
    ("key", "least"),
    [
        ("supervisor__tension_stopping", 220.0),
        ("supervisor__contact_stopping", 27.5),
        ("supervisor__contact_at_once", 35.0),
        ("supervisor__speed_stopping", 1.5),
        ("supervisor__rotation_stopping", 3.0),
    ],
)
def test_bounds_that_would_stop_a_daemon_that_is_right(key: str, least: float) -> None:
    for value, fine in ((0.99 * least, False), (1.001 * least, True)):
        config, _ = load("config/can.yaml", overrides={key.replace("__", "."): value, "lab": None})
        found = [each.where for each in check_supervisor(config) if not each.ok]
        assert (key.replace("__", ".") not in found) is fine


@pytest.mark.parametrize(
    ("given", "least"),
    [
        # 10 waiting, 3 landing, 15 passive; 1.875 (0.464 m / 0.225 m/s + 0.3) s down, 3 times 0.3
        ({}, 28.0 + 3.865 + 0.563 + 0.9),
        ({"control.sequence.stop_s": 2.0}, 28.0 + 3.865 + 3.75 + 6.0),
        ({"control.sequence.lower_s": 10.0}, 28.0 + 10.0 + 0.9),
        ({"control.sequence.hold_s": 4.0}, 22.0 + 3.865 + 0.563 + 0.9),
    ],
)
def test_how_long_a_right_stop_may_last(given: dict[str, Any], least: float) -> None:
    """Supervisor's stop_s is no less."""
    for value, fine in ((0.99 * least, False), (1.01 * least, True)):
        stated = {**given, "supervisor.stop_s": value, "lab": None}
        config, _ = load("config/can.yaml", overrides=stated)
        found = {each.where for each in check_supervisor(config) if not each.ok}
        assert ("supervisor.stop_s" not in found) is fine, value


def test_bounds_that_a_robot_in_order_may_reach() -> None:
    config, _ = load("config/can.yaml", overrides={"lab": None})
    braked, _ = load("config/braked.yaml", overrides={"lab": None})
    for key, least, robot, others in (
        ("axis_torque_ms", 22.0, config, {}),
        ("axis_torque_ms", 32.0, config, {"stale_ms": 30.0}),
        ("disarmed_ms", 8.0, config, {}),
        ("disarmed_ms", 28.0, braked, {}),
        ("stopping_ms", 100.0, config, {}),
        ("window_ms", 8.0, config, {}),
        ("opposed_ms", 10.0, config, {}),
        ("opposed_error", 1.0, config, {}),
        ("frozen_frames", 3, config, {}),
        ("frozen_rate", 0.01, config, {}),
        ("frozen_tension", 0.02, config, {}),
        ("logged_ticks", 2, config, {}),
        ("margin", 1.05, config, {}),
        ("rotation", 0.3, config, {}),
        ("rotation_stopping", 3.0, config, {}),
        ("rotation_stopping", 3.2, config, {"rotation": 3.2}),
        ("speed_stopping", 1.5, config, {}),
        ("speed_on_path", 0.4, config, {}),
        ("speed_in_descent", 0.7, config, {}),
        ("rotation_in_descent", 4.5, config, {}),
        ("unexplained_force", 67.5, config, {}),
        ("opposed_force", 45.0, config, {}),
        ("logged_tension", 6.75, config, {}),
        ("opposed_long_force", 13.5, config, {}),
        ("opposed_long_error", 4.5, config, {}),
        ("excess_force", 270.0, config, {}),
        ("answered_torque", 2.25, config, {}),
        ("passive_torque", 1.125, config, {}),
    ):
        assert robot.supervisor is not None
        for value, count in ((least * 0.999, 1), (least, 0)):
            settings = robot.supervisor.model_copy(update={**others, key: value})
            given = robot.model_copy(update={"supervisor": settings})
            found = [each.where for each in check_supervisor(given) if not each.ok]
            assert found.count(f"supervisor.{key}") == count


def test_drives_that_wait_for_less_than_its_period_allows() -> None:
    found = refused("config/can.yaml", lab=None, supervisor__timeout_ms=21)
    assert [each.where for each in found] == ["supervisor.timeout_ms"]
    assert "needs 22 ms" in found[0].text


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("timeout_ms", 201),
        ("timeout_ms", 70_000),
        ("period_ms", 21),
        ("patience_ms", 101),
        ("margin", 0.9),
        ("margin", 1.6),
        ("stop_s", 1e9),
        ("stale_ms", 101),
        ("axis_torque_ms", 301),
        ("frozen_frames", 101),
        ("stopping_ms", 501),
        ("disarmed_ms", 201),
        ("window_ms", 101),
        ("quiet_s", 2.1),
        ("frozen_rate", 0.21),
        ("frozen_tension", 2.1),
        ("rotation", 5.1),
        ("rotation_stopping", 31),
        ("opposed_error", 21),
        ("spread", 0.21),
        ("unexplained_force", 201),
        ("unexplained_share", 0.51),
        ("opposed_force", 201),
        ("logged_tension", 51),
        ("tension_stopping", 2000.1),
        ("contact_stopping", 101),
        ("speed_stopping", 5.1),
        ("contact_at_once", 201),
        ("opposed_long_force", 101),
        ("opposed_long_error", 51),
        ("excess_force", 501),
        ("speed_on_path", 2.1),
        ("speed_in_descent", 3.1),
        ("rotation_in_descent", 10.1),
        ("opposed_ms", 101),
        ("passive_torque", 101),
        ("damped_share", 0.39),
        ("damped_share", 0.76),
    ],
)
def test_a_bound_of_any_size_is_none(key: str, value: float) -> None:
    with pytest.raises(ConfigError) as error:
        load("config/can.yaml", overrides={f"supervisor.{key}": value})
    assert f"supervisor.{key}" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("key", "value"), [("policy", "use"), ("period_ms", 6), ("patience_ms", 11), ("timeout_ms", 51)]
)
def test_what_only_a_lab_may_state(key: str, value: Any) -> None:
    stated = {f"supervisor.{key}": value}
    load("config/can.yaml", overrides=stated)
    with pytest.raises(ConfigError, match=f"or write supervisor.{key} under relaxed"):
        load("config/can.yaml", overrides=ROBOT | stated)
    load("config/can.yaml", overrides=ROBOT | stated | {"relaxed": [f"supervisor.{key}"]})


@pytest.mark.parametrize(
    ("key", "most"),
    [
        ("axis_torque_ms", 200),
        ("stale_ms", 40),
        ("disarmed_ms", 100),
        ("stopping_ms", 120),
        ("window_ms", 50),
        ("opposed_ms", 50),
        ("frozen_frames", 20),
        ("logged_ticks", 16),
        ("rotation", 3),
    ],
)
def test_times_that_let_a_mistake_grow(key: str, most: int) -> None:
    quiet = {"supervisor__quiet_s": 0.5}
    beyond = quiet | {f"supervisor__{key}": most + 1}
    assert refused("config/can.yaml", **beyond) == []
    found = refused("config/can.yaml", lab=None, **beyond)
    assert [(each.where, each.remedy) for each in found] == [
        (f"supervisor.{key}", f"set it to at most {most}")
    ]
    at_most = quiet | {f"supervisor__{key}": most}
    assert refused("config/can.yaml", lab=None, **at_most) == []


def test_power_now_and_then_is_not_forgotten_between() -> None:
    short = {"supervisor__quiet_s": 0.19}
    assert refused("config/can.yaml", **short) == []
    (found,) = refused("config/can.yaml", lab=None, **short)
    assert (found.where, found.remedy) == ("supervisor.quiet_s", "set it to at least 0.2")
    assert "after 0.19 s without power it forgets power that a disarmed daemon" in found.text


def told(path: str, **overrides: Any) -> dict[str, str]:
    """What the rule says of what is in order, by key."""
    found = check_parts(*load(path, overrides=overrides))
    return {each.where: each.text for each in found if each.rule == "supervisor" and each.ok}


def test_how_fast_drives_on_can_stop_is_told() -> None:
    patient = {"supervisor.patience_ms": 6.5, "supervisor.timeout_ms": 24}
    found = check_parts(*load("config/can.yaml", overrides=ROBOT | patient))
    texts = [each.text for each in found if each.rule == "supervisor"]
    times = "drives begin to stop 32.5 ms after a mistake shows that may last patience_ms, 136 ms"
    late = "8.5 ms later if it looks as late as SUP-24 lets it"
    assert any(text.startswith(times) and text.endswith(late) for text in texts)


_DRIVE = "fieldbus.drive"


def test_drives_that_do_nothing_when_the_heartbeat_ends() -> None:
    """An EPOS4 and a plain drive; in a lab nobody is hurt."""
    ignores = {
        f"{_DRIVE}.supported_options.abort_connection": [0, 2, 3],
        f"{_DRIVE}.on_communication_error": 1,
    }
    for code, more, said in ((None, {}, "is not stated"), (0, ignores, "is 0: it does nothing")):
        stated = {f"{_DRIVE}.options.abort_connection": code} | more
        assert findings(*load("config/can.yaml", overrides=stated)) == []
        found = findings(*load("config/can.yaml", overrides=ROBOT | stated))
        assert [each.where for each in found] == [f"{_DRIVE}.options.abort_connection"]
        assert said in found[0].text
        assert found[0].remedy == "state a code with which it stops: 2, 3"
    none = {
        f"{_DRIVE}.options.abort_connection": None,
        f"{_DRIVE}.supported_options.abort_connection": [],
    }
    found = findings(*load("config/can.yaml", overrides=ROBOT | none))
    assert "use another drive" in found[0].remedy


@pytest.mark.parametrize(
    ("errors", "refused_", "tells"),
    [
        ([{"code": 0x8130, "text": "lost", "reaction": "warning"}], "errors", True),
        ([{"code": 0x8100, "last": 0x81FF, "text": "bus", "reaction": "warning"}], "errors", True),
        ([{"code": 0x8131, "text": "other", "reaction": "warning"}], _ABORT, True),
        ([{"code": 0x8129, "text": "other", "reaction": "warning"}], _ABORT, True),
        ([{"code": 0x8130, "text": "lost", "reset": "communication_reset"}], "", False),
        ([{"code": 0x8130, "text": "lost", "reaction": "power_off"}], "", True),
        ([{"code": 0x8130, "text": "lost", "reaction": "abort_connection"}], _ABORT, True),
    ],
)
def test_what_drives_make_of_a_heartbeat_that_ended(
    errors: list[dict[str, Any]], refused_: str, tells: bool
) -> None:
    """That they only warn is refused, and so are those that an ordinary controlword enables again,
    since they are not in FAULT; that a fault reset brings them back is told."""
    stated = {f"{_DRIVE}.errors": errors}
    found = findings(*load("config/can.yaml", overrides=ROBOT | stated))
    assert [each.where for each in found] == [f"{_DRIVE}.{refused_}"] * bool(refused_)
    texts = told("config/can.yaml", **(ROBOT | stated))
    assert ("a fault reset alone enables" in texts.get(f"{_DRIVE}.errors", "")) is tells
    assert f"{_DRIVE}.errors" not in told("config/can.yaml", **stated), "a lab"
    assert findings(*load("config/can.yaml", overrides=stated)) == [], "a lab"


@pytest.mark.parametrize(("code", "count"), [(1, 0), (2, 1), (3, 1)])
def test_a_plain_drive_that_is_not_in_fault(code: int, count: int) -> None:
    """With 2 its power is off, and with 3 it brakes and stays in quick stop: 690 N on all axes held
    946 N to the end, as long as the daemon went on."""
    drive = load("config/can.yaml")[0].fieldbus.drive.model_dump()  # type: ignore[union-attr]
    errors = [
        {**each, "reset": "fault_reset"} if each["code"] == 0x8130 else each
        for each in drive["errors"]
    ]
    stated = {
        f"{_DRIVE}.errors": errors,
        f"{_DRIVE}.{_ABORT}": code,
        f"{_DRIVE}.supported_options.abort_connection": [1, 2, 3],
    }
    found = findings(*load("config/can.yaml", overrides=ROBOT | stated))
    assert [each.where for each in found] == [f"{_DRIVE}.{_ABORT}"] * count


def test_drives_that_act_by_more_than_the_supervisor_reads() -> None:
    """A torque offset, or a mode of operation, in each PDO."""
    for entry, name in ((0x60B20010, "0x60B2"), (0x60600008, "0x6060")):
        stated = {f"{_DRIVE}.rpdo": [0x60400010, 0x60710010, entry]}
        assert findings(*load("config/can.yaml", overrides=stated)) == []
        found = findings(*load("config/can.yaml", overrides=ROBOT | stated))
        assert [each.where for each in found] == [f"{_DRIVE}.rpdo"]
        assert name in found[0].text


@pytest.mark.parametrize(
    ("ramp", "reaction", "refused_"),
    [(47000, 3, False), (46000, 3, True), (None, 3, True), (1, 2, False)],
)
def test_a_ramp_on_which_a_drum_hardly_brakes(
    ramp: int | None, reaction: int, refused_: bool
) -> None:
    """Its drive follows it after the heartbeat, with a torque of its own: 0.1 s from 0.8 m/s are
    46,500 rpm/s. With its power off (2) there is no ramp."""
    stated = {
        "robot.motor.quick_stop_rpm_s": ramp,
        f"{_DRIVE}.options.abort_connection": reaction,
    }
    assert findings(*load("config/can.yaml", overrides=stated)) == []
    found = findings(*load("config/can.yaml", overrides=ROBOT | stated))
    assert [each.where for each in found] == ["robot.motor.quick_stop_rpm_s"] * refused_


def _ramps(*settings: dict[str, Any]) -> list[str]:
    """Where a robot is refused whose drives have these instead of their own ramp."""
    drive = load("config/can.yaml")[0].fieldbus.drive.model_dump()  # type: ignore[union-attr]
    others = [each for each in drive["settings"] if each["index"] != 0x6085]
    stated = ROBOT | {f"{_DRIVE}.settings": [*others, *settings]}
    return [each.where for each in findings(*load("config/can.yaml", overrides=stated))]


def test_a_ramp_that_is_not_the_motors() -> None:
    """Written once, from the quantity: what is written behind it is what the drive has."""
    own = {"index": 0x6085, "length": 4, "quantity": "motor.quick_stop_rpm_s", "unit": "rpm/s"}
    own, fixed = own | {"why": "ramp"}, {"index": 0x6085, "length": 4, "value": 10, "why": "ramp"}
    assert _ramps(own) == []
    for settings in ((), (fixed,), (own, fixed), (own, own)):
        assert _ramps(*settings) == [f"{_DRIVE}.settings"]


@pytest.mark.parametrize(
    ("lost", "abort", "fault", "quick", "ramp"),
    [
        (None, 1, 2, 6, 0x6085),
        (None, 1, 1, 6, 0x6084),
        (None, 1, 0, 6, None),
        (None, 1, None, 1, 0x6085),
        (None, 3, 1, 2, 0x6085),
        (None, 3, 2, 1, 0x6084),
        (None, 3, 2, 5, 0x6084),
        (None, 3, 2, 0, None),
        (None, 2, 1, 1, None),
        ("abort_connection", 3, 1, 6, 0x6085),
        ("fault_reaction", 2, 2, 1, 0x6085),
        ("fault_reaction", 3, 1, 6, 0x6084),
        ("power_off", 3, 1, 1, None),
    ],
)
def test_which_ramp_a_drive_brakes_on(
    lost: str | None, abort: int, fault: int | None, quick: int, ramp: int | None
) -> None:
    """What it makes of error 0x8130, then 0x6007, then 0x605E or 0x605A; the ramp of that has to be
    the motor's, and no other."""
    profile = load("config/can.yaml")[0].fieldbus.drive  # type: ignore[union-attr]
    options = profile.options.model_copy(
        update={"abort_connection": abort, "fault_reaction": fault, "quick_stop": quick}
    )
    errors = [
        error.model_copy(update={"reaction": lost}) if error.code == 0x8130 else error
        for error in profile.errors
    ]
    assert _ramp_of(profile.model_copy(update={"options": options, "errors": errors})) == ramp


def test_a_slow_down_ramp_that_nobody_bounds() -> None:
    """A drive that brakes on it has to be sent the motor's ramp there (0x6084)."""
    own = {"index": 0x6084, "length": 4, "quantity": "motor.quick_stop_rpm_s", "unit": "rpm/s"}
    own, fixed = own | {"why": "ramp"}, {"index": 0x6084, "length": 4, "value": 300, "why": "ramp"}
    drive = load("config/can.yaml")[0].fieldbus.drive.model_dump()  # type: ignore[union-attr]
    slow = {
        f"{_DRIVE}.options.abort_connection": 1,
        f"{_DRIVE}.options.fault_reaction": 1,
        f"{_DRIVE}.supported_options.abort_connection": [1],
    }
    for more, refused_ in (((), True), ((fixed,), True), ((own,), False)):
        stated = ROBOT | slow | {f"{_DRIVE}.settings": [*drive["settings"], *more]}
        found = {each.where for each in findings(*load("config/can.yaml", overrides=stated))}
        assert (f"{_DRIVE}.settings" in found) == refused_


def test_a_slow_drum_in_a_stop_makes_no_slow_ramp_right() -> None:
    """A drum may be fast all the same."""
    stated = {"control.stop.reel_in": 0.05, "robot.motor.quick_stop_rpm_s": 3000}
    found = findings(*load("config/can.yaml", overrides=ROBOT | stated))
    assert "robot.motor.quick_stop_rpm_s" in {each.where for each in found}


def test_an_object_that_is_sent_twice() -> None:
    """The drive acts by the second, and the first is judged."""
    stated = {f"{_DRIVE}.rpdo": [0x60400010, 0x60710010, 0x60710010]}
    found = findings(*load("config/can.yaml", overrides=ROBOT | stated))
    assert f"{_DRIVE}.rpdo" in {each.where for each in found}


@pytest.mark.parametrize(("digits", "refused_"), [(2, True), (1, False)])
def test_cells_whose_numbers_end_below_a_bound(digits: int, refused_: bool) -> None:
    """Sixteen bits: 327 N with two digits, 3277 N with one."""
    cell = {"tpdo": [0x71300110], "decimal_digits": digits}
    stated = ROBOT | {f"fieldbus.force_cell.{key}": value for key, value in cell.items()}
    stated |= {"control.tension.max": 300.0, "supervisor.tension_stopping": 340.0}
    stated["control.isolation.given_up_tension"] = 360.0
    for path in ("config/can.yaml", "config/ethercat.yaml"):
        found = findings(*load(path, overrides=stated))
        assert ("fieldbus.force_cell" in {each.where for each in found}) == refused_


def test_drives_whose_heartbeats_are_far_apart() -> None:
    """A silent drive may then be a pulled one for as long."""
    for period_ms, refused_ in ((200, False), (201, True)):
        stated = {f"{_DRIVE}.heartbeat_ms": period_ms}
        found = findings(*load("config/can.yaml", overrides=ROBOT | stated))
        assert [each.where for each in found] == [f"{_DRIVE}.heartbeat_ms"] * refused_


def test_a_frame_that_is_a_plane_above_the_robot_has_a_height() -> None:
    """Of six cables that hang from one height, half of its own height is no bound."""
    found = refused("config/six.yaml", lab=None)
    assert "supervisor.spread" not in [each.where for each in found]


def test_what_a_wrong_passive_stop_may_lift_is_said() -> None:
    found = refused("config/can.yaml", lab=None, control__stop__passive_tension=45.0)
    assert [each.where for each in found] == ["control.stop.passive_tension"]
    assert "lifts the platform of 23 N with 124 N, and is not found" in found[0].text
    assert found[0].remedy == "set it to at most 22.8"
