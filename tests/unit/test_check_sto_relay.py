"""What `tonus check` and the loader refuse: a relay of the STO inputs that could not stop the robot
in time, or that nobody could hold."""

from __future__ import annotations

from typing import Any

import pytest

from tonus.config import ConfigError, load
from tonus.tools.check.finding import Finding
from tonus.tools.check.rules import check_parts
from tonus.tools.errors import ToolError
from tonus.tools.run.supervision import require_reach, wanted, without_relay

PATH = "config/ethercat.yaml"


def findings(path: str = PATH, overrides: dict[str, Any] | None = None) -> list[Finding]:
    found = check_parts(*load(path, overrides=overrides))
    return [each for each in found if each.rule in ("sto_relay", "supervisor")]


def refused(path: str = PATH, **overrides: Any) -> list[str]:
    stated = {key.replace("__", "."): value for key, value in overrides.items()}
    return [each.where for each in findings(path, stated) if not each.ok]


def test_the_shipped_segment_is_within_the_supervisors_reach() -> None:
    assert refused() == []
    assert refused(lab=None) == []
    assert wanted(load(PATH)[0])
    require_reach(load(PATH, overrides={"supervisor.policy": "require"})[0])


def test_how_long_the_drives_have_torque_is_said() -> None:
    robot = [each.text for each in findings(overrides={"lab": None}) if each.rule == "sto_relay"]
    assert robot[-2] == (
        "no drive has torque 44 ms after the supervisor's end at the latest, 44 ms after the "
        "daemon's last record; 7 ms later if it looks as late as SUP-24 lets it"
    )


@pytest.mark.parametrize("lab", [{"lab": None}, {}], ids=["robot", "lab"])
@pytest.mark.parametrize(("release_ms", "off_ms", "ok"), [(25, 25, True), (25, 25.1, False)])
def test_a_relay_that_opens_too_late(
    lab: dict[str, Any], release_ms: float, off_ms: float, ok: bool
) -> None:
    times = {"sto_relay__release_ms": release_ms, "sto_relay__torque_off_ms": off_ms}
    assert refused(**lab, **times) == ([] if ok else ["sto_relay.release_ms"])


def test_a_relay_that_opens_later_than_power_may_last() -> None:
    """However long a disarmed drive may have power: nothing else ends a wrong torque."""
    times = {"supervisor__disarmed_ms": 75, "sto_relay__torque_off_ms": 25}
    assert refused(lab=None, sto_relay__release_ms=25, **times) == []
    assert refused(lab=None, sto_relay__release_ms=25.1, **times) == ["sto_relay.release_ms"]


def test_without_a_relay_the_segment_is_out_of_reach() -> None:
    assert refused(lab=None, sto_relay=None) == ["supervisor.policy"]
    assert not wanted(load(PATH, overrides={"sto_relay": None})[0])


def test_without_a_supervisor_the_relay_is_bridged() -> None:
    config, _ = load(PATH, overrides={"supervisor.policy": "off"})
    assert config.sto_relay is not None
    assert config.relay is None
    assert not wanted(config)
    assert without_relay(load(PATH)[0]).relay is None
    assert [
        each for each in findings(overrides={"supervisor": None}) if each.rule == "sto_relay"
    ] == []


def test_drives_on_can_have_no_relay() -> None:
    relay = load(PATH)[0].sto_relay
    assert relay is not None
    beside = {"sto_relay": relay.model_dump(mode="json")}
    assert "sto_relay" in [
        each.where for each in findings("config/can.yaml", beside) if not each.ok
    ]
    with pytest.raises(ToolError, match="sto_relay is for robots without a drive on CAN"):
        require_reach(load("config/can.yaml", overrides=beside)[0])


def test_a_channel_that_is_not_its_own() -> None:
    relay = load(PATH)[0].sto_relay
    assert relay is not None
    stated = relay.model_dump(mode="json") | {"channel": "can1"}
    assert refused("config/mixed.yaml", sto_relay=stated) == ["sto_relay.channel"]
    assert refused("config/mixed.yaml", sto_relay=stated | {"channel": "sto"}) == []


@pytest.mark.parametrize("key", ["sto_relay__node_id", "sto_relay__master__node_id"])
def test_a_node_with_the_supervisors_number(key: str) -> None:
    assert refused(**{key: 126}) == ["sto_relay.node_id"]


def test_a_node_with_the_masters_number() -> None:
    with pytest.raises(ConfigError, match="node_id 127 is the master's too"):
        load(PATH, overrides={"sto_relay.node_id": 127})


@pytest.mark.parametrize(("timeout_ms", "ok"), [(20, False), (21, True)])
def test_a_node_that_does_not_bear_a_lost_heartbeat(timeout_ms: int, ok: bool) -> None:
    expected = [] if ok else ["sto_relay.timeout_ms"]
    assert refused(sto_relay__timeout_ms=timeout_ms) == expected


@pytest.mark.parametrize(("periods", "ok"), [(7, False), (8, True)])
def test_a_robot_that_does_not_bear_a_lost_heartbeat_of_the_node(periods: int, ok: bool) -> None:
    """Of 10 ms each, with 60 ms of jitter in a lab; without a statement it follows from these."""
    expected = [] if ok else ["sto_relay.master.heartbeat_periods"]
    assert refused(sto_relay__master__heartbeat_periods=periods) == expected
    told = [each.text for each in findings() if each.where.endswith("heartbeat_periods")]
    assert told == [
        "the robot is stopped after 80 ms without its node's heartbeat, sent every 10 ms; 1 lost "
        "and 60 ms of jitter need 80 ms"
    ]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("timeout_ms", 101),
        ("closing_ms", 100.1),
        ("release_ms", 100.1),
        ("release_ms", -1),
        ("torque_off_ms", 100.1),
        ("rpdo", [0x60400010]),
        ("tpdo", [0x60410010]),
    ],
)
def test_values_that_no_relay_has(key: str, value: Any) -> None:
    with pytest.raises(ConfigError) as error:
        load(PATH, overrides={f"sto_relay.{key}": value})
    assert "sto_relay" in str(error.value)
    assert "\n" not in str(error.value)


def test_how_long_only_a_lab_may_wait() -> None:
    stated = {"sto_relay.timeout_ms": 21}
    load(PATH, overrides=stated)
    with pytest.raises(ConfigError, match=r"or write sto_relay\.timeout_ms under relaxed"):
        load(PATH, overrides={"lab": None} | stated)
    load(PATH, overrides={"lab": None, "relaxed": ["sto_relay.timeout_ms"]} | stated)
    assert load(PATH, overrides={"lab": None})[0].sto_relay.timeout_ms == 7  # type: ignore[union-attr]
