"""What a configuration of a segment, or of several buses, may say, and what is said about it."""

from __future__ import annotations

import sys
from typing import Any

import pytest

from tonus.config import ConfigError, load
from tonus.drivers.errors import BringUpError
from tonus.drivers.ethercat.soem import SoemMaster
from tonus.tools.check.losses import check_losses
from tonus.tools.fieldbus.registry import fieldbus_kind


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        ({"fieldbus.slaves.1.axis": 0}, "axis 0 has more than one slave"),
        ({"fieldbus.slaves.9.cells": [7]}, "cell 7 has more than one slave"),
        ({"fieldbus.slaves": [{"axis": 0}]}, "no slave for axis 1"),
        ({"fieldbus.slaves.0": {"axis": 0, "cells": [1]}}, "either an axis or cells"),
        ({"fieldbus.drive.ethercat.tpdo": [0x60410010] * 13}, "a PDO of the drive holds 12"),
        ({"fieldbus.master.state_policy": "ignore"}, "recover"),
    ],
)
def test_a_segment_that_cannot_be_is_refused_with_its_place(
    overrides: dict[str, Any], told: str
) -> None:
    with pytest.raises(ConfigError, match=told) as refused:
        load("config/ethercat.yaml", overrides=overrides)
    assert "fieldbus" in str(refused.value)


def test_a_device_on_two_buses_or_none_is_refused() -> None:
    with pytest.raises(ConfigError, match="axis 0 has more than one"):
        load("config/mixed.yaml", overrides={"fieldbus.buses.0.slaves.1.axis": 0})
    channels = {"fieldbus.buses.1.channels.0.force_cells": []}
    with pytest.raises(ConfigError, match="no device for cell 0"):
        load("config/mixed.yaml", overrides=channels)


def _failed(overrides: dict[str, Any]) -> set[str]:
    config, _ = load("config/ethercat.yaml", overrides=overrides)
    of_bus = fieldbus_kind(config.fieldbus).check(config, config.fieldbus)
    findings = [*of_bus, *check_losses(config)]
    return {finding.rule for finding in findings if not finding.ok}


@pytest.mark.parametrize(
    ("overrides", "rule"),
    [
        ({"fieldbus.drive.interpolation_ms": 1}, "interpolation"),
        ({"fieldbus.clocks.frame_us": 55.0}, "SYNC0"),
        ({"fieldbus.master.watchdog_ms": 61}, "watchdog"),
        ({"tolerance.lost.ethercat": 3}, "lost frames"),
        ({"fieldbus.master.receive_timeout_us": 800}, "lost frames"),
        ({"lab.ethercat.interface": "tonus0"}, "interfaces"),
        ({"lab.ethercat": None}, "lab"),
    ],
)
def test_check_finds_what_does_not_fit(overrides: dict[str, Any], rule: str) -> None:
    assert _failed({}) == set()
    assert rule in _failed(overrides)


def test_without_pysoem_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pysoem", None)
    config, _ = load("config/ethercat.yaml")
    with pytest.raises(BringUpError, match=r"pip install 'tonus\[ethercat\]'"):
        SoemMaster(config.fieldbus, lambda: 0)  # type: ignore[arg-type]
