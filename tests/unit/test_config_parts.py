"""A part of a configuration, given as a whole one, is one line that names its key."""

from __future__ import annotations

from pathlib import Path

import pytest

from tonus.config import ConfigError, load
from tonus.config.loader import HERE


@pytest.mark.parametrize(
    ("file", "key"),
    [
        ("tracker.yaml", "tracker"),
        ("realtime.yaml", "realtime"),
        ("supervisor.yaml", "supervisor"),
        ("robots/paper.yaml", "robot"),
        ("buses/can4.yaml", "fieldbus"),
        ("buses/ethercat.yaml", "fieldbus"),
        ("drives/epos4.yaml", "fieldbus.drive"),
    ],
)
def test_a_part_is_named_with_its_key(file: str, key: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load(HERE / file)
    told = caught.value
    assert told.problem == f"is no whole configuration but its part {key}"
    assert told.remedy == f"name the file that has {key.split('.')[-1]}: !include {Path(file).name}"
    assert told.others == ()


def test_a_misspelt_key_does_not_hide_what_a_part_is(tmp_path: Path) -> None:
    text = (HERE / "tracker.yaml").read_text(encoding="utf-8").replace("port:", "prot:")
    (tmp_path / "tracker.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match="its part tracker;"):
        load(tmp_path / "tracker.yaml")


def test_a_scenario_is_one() -> None:
    with pytest.raises(ConfigError, match=r"is a scenario; name a configuration, and this with"):
        load(HERE / "scenarios" / "load_test.yaml")


def test_what_lacks_a_few_sections_is_no_part(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("name: mine\ntracker: {}\nzeta: 1\neta: 2\nalpha: 3\nscenario: hold\n")
    with pytest.raises(ConfigError) as caught:
        load(path)
    told = [caught.value, *caught.value.others]
    unknown = [each.line for each in told if each.problem == "is not a key here"]
    assert unknown == [3, 4, 5], "in the order of the file"


def test_every_whole_configuration_is_still_one() -> None:
    for file in HERE.glob("*.yaml"):
        if "\nfieldbus:" in file.read_text(encoding="utf-8"):
            load(file)
