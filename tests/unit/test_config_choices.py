"""A value that may be of several types: one line that names them all, in the words of YAML."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from tonus.config import ConfigError, load
from tonus.config.loader import load_parameter_study

PROCESSOR = "input should be a whole number >= 0 or quietest, not "
PROCESSORS = "input should be a whole number >= 0, a list of whole numbers >= 0 or others, not "
SEEDS = "input should be a whole number >= 1 or a list of 1 or more whole numbers >= 0, not "
VALUES = (
    "input should be a list of 1 or more values, a mapping with low, high, steps or a mapping with "
    "low, high, not "
)
JARGON = re.compile(r"0x[0-9a-f]{6}|functools|function-|literal\[|tuple|dictionary|instance|None")
STUDY = "name: s\nconfigs: [config/direct.yaml]\nscenarios: [hold]\n"


def only(caught: pytest.ExceptionInfo[ConfigError]) -> ConfigError:
    """The one line there is, in words that are not the validator's own."""
    assert caught.value.others == ()
    assert not JARGON.search(str(caught.value))
    return caught.value


@pytest.mark.parametrize(
    ("key", "value", "at", "said"),
    [
        ("realtime.daemon_cpu", "fast", "", f"{PROCESSOR}'fast'"),
        ("realtime.daemon_cpu", -3, "", f"{PROCESSOR}-3"),
        ("realtime.daemon_cpu", 1.5, "", f"{PROCESSOR}1.5"),
        ("realtime.daemon_cpu", True, "", f"{PROCESSOR}true"),
        ("realtime.lab_cpu", "fast", "", f"{PROCESSORS}'fast'"),
        ("realtime.lab_cpu", {}, "", f"{PROCESSORS}{{}}"),
        ("realtime.lab_cpu", [1, -1], ".1", "input should be greater than or equal to 0, not -1"),
        ("realtime.lab_cpu", ["a"], ".0", "input should be a whole number, not 'a'"),
        ("tracker", None, "", "input should be a mapping, not null"),
        ("tracker", [1], "", "input should be a mapping, not [1]"),
        ("fieldbus", None, "", "input should be a mapping, not null"),
        ("fieldbus.channels", 3, "", "input should be a list, not 3"),
        ("operation.scenarios", "hold", "", "input should be a list, not 'hold'"),
        ("name", 3, "", "input should be a text, not 3"),
        ("realtime.lock_memory", "maybe", "", "input should be true or false, not 'maybe'"),
    ],
)
def test_a_value_of_another_type_is_one_line(key: str, value: Any, at: str, said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load("config/can.yaml", overrides={key: value})
    told = only(caught)
    assert (told.key, told.problem) == (key + at, said)


@pytest.mark.parametrize(
    ("text", "key", "said"),
    [
        ("seeds: -1", "seeds", f"{SEEDS}-1"),
        ("seeds: ten", "seeds", f"{SEEDS}'ten'"),
        ("seeds: 1.5", "seeds", f"{SEEDS}1.5"),
        ("seeds: []", "seeds", "has 0 items, and takes at least 1"),
        ("seeds: [a]", "seeds.0", "input should be a whole number, not 'a'"),
        ("parameters: {x.force_gain: 5}", "parameters.x.force_gain", f"{VALUES}5"),
        ("parameters: {x: []}", "parameters.x", "has 0 items, and takes at least 1"),
        ("parameters: {x: {low: 1, high: 2, steps: 1}}", "parameters.x.steps",
         "input should be greater than or equal to 2, not 1"),
        ("parameters:", "parameters", "input should be a mapping, not null"),
    ],
)  # fmt: skip
def test_a_value_of_a_study_is_one_line(tmp_path: Path, text: str, key: str, said: str) -> None:
    path = tmp_path / "study.yaml"
    path.write_text(f"{STUDY}{text}\n", encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_parameter_study(path)
    told = only(caught)
    assert (told.file, told.line, told.key, told.problem) == (str(path), 4, key, said)
