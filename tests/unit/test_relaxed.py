"""Without a lab section a configuration has a robot's values, and says so where it has others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from tonus.config import Config, ConfigError, load
from tonus.config.document import dotted
from tonus.config.loader import HERE
from tonus.config.schema.place import DEFAULTS, with_defaults
from tonus.tools.cli.check import check

KEYS = [dotted(key) for key in DEFAULTS]
WITHOUT_LAB: dict[str, Any] = {"lab": None}


RELAY = "sto_relay.timeout_ms"
"""of a section that config/ethercat.yaml alone has"""


def values(config: Config) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key in DEFAULTS:
        if dotted(key) == RELAY and config.sto_relay is None:
            continue
        place: Any = config
        for part in key:
            place = getattr(place, str(part))
        found[dotted(key)] = place
    return found


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """What docs/commissioning.md advises: the lab's file without its ``lab:`` line."""
    lines = (HERE / "can.yaml").read_text(encoding="utf-8").splitlines()
    kept = [line for line in lines if not line.startswith("lab:")]
    path = tmp_path / "mine.yaml"
    path.write_text("\n".join(kept).replace("!include ", f"!include {HERE}/") + "\n")
    return path


@pytest.mark.parametrize("name", ["can", "direct", "ethercat", "mixed"])
def test_the_labs_file_without_its_lab_has_the_values_of_a_robot(name: str) -> None:
    indulgent, _ = load(f"config/{name}.yaml")
    has = set(KEYS) if indulgent.sto_relay is not None else set(KEYS) - {RELAY}
    assert has == set(KEYS) or name != "ethercat"
    pairs = {dotted(key): pair for key, pair in DEFAULTS.items() if dotted(key) in has}
    assert values(indulgent) == {key: lab for key, (_, lab) in pairs.items()}
    safe, _ = load(f"config/{name}.yaml", overrides=WITHOUT_LAB)
    assert values(safe) == {key: robot for key, (robot, _) in pairs.items()}
    shipped = values(load("config/robot.yaml")[0])
    assert {key: value for key, value in values(safe).items() if key != RELAY} == shipped


def test_a_copied_file_requires_and_stops(copied: Path) -> None:
    config, _ = load(copied)
    assert (config.realtime.policy, config.realtime.overrun) == ("require", "stop")
    assert config.control.freshness.stale_stop_ticks == 5
    result = CliRunner().invoke(check, [str(copied)])
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("realtime.policy", "prefer"),
        ("realtime.policy", "off"),
        ("realtime.overrun", "skip"),
        ("realtime.overrun_ticks", 4),
        ("control.freshness.stale_stop_ticks", 25),
        ("tolerance.jitter_ms", 60),
    ],
)
def test_a_value_that_is_less_safe_needs_a_word_for_it(key: str, value: Any) -> None:
    stated = {key: value}
    load("config/can.yaml", overrides=stated)
    with pytest.raises(ConfigError) as refused:
        load("config/can.yaml", overrides=WITHOUT_LAB | stated)
    told = str(refused.value)
    assert "\n" not in told
    assert f" {key}: " in told
    assert f"or write {key} under relaxed" in told
    config, _ = load("config/can.yaml", overrides=WITHOUT_LAB | stated | {"relaxed": [key]})
    assert values(config)[key] == value


@pytest.mark.parametrize("overrun", ["stop", "hold"])
def test_safe_values_need_no_word(overrun: str) -> None:
    stated = {"realtime.overrun": overrun, "control.freshness.stale_stop_ticks": 10}
    load("config/can.yaml", overrides=WITHOUT_LAB | stated)


def test_a_named_key_that_is_left_out_has_the_labs_value() -> None:
    config, _ = load("config/can.yaml", overrides=WITHOUT_LAB | {"relaxed": KEYS})
    assert values(config) == values(load("config/can.yaml")[0])


def test_a_key_that_cannot_be_relaxed_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"relaxed.0: .*realtime.policy.*choose one of these"):
        load("config/can.yaml", overrides={"relaxed": ["control.envelope.speed_limit"]})


@pytest.mark.parametrize("data", [None, 3, [], {}, {"realtime": 4, "relaxed": 7, "control": []}])
def test_what_is_no_configuration_is_left_to_the_schema(data: Any) -> None:
    found = with_defaults(data)
    if isinstance(data, dict):
        assert found == data | {"tolerance": {"jitter_ms": 20}}
    else:
        assert found == data


def test_the_data_that_is_filled_stays_as_it_is() -> None:
    data: dict[str, Any] = {"realtime": {}, "control": {"freshness": {}}, "lab": None}
    filled = with_defaults(data)
    assert data == {"realtime": {}, "control": {"freshness": {}}, "lab": None}
    assert filled["realtime"] == {"policy": "require", "overrun": "stop", "overrun_ticks": 3}
