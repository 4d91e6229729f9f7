"""A fieldbus outside the package, by its name: the one of the tutorial, brought up, run, logged,
replayed and checked, or refused; and the contract, on it and on every shipped kind."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path
from typing import Any

import pytest
from loop import QUICK

from tonus.config import Config, ConfigError, load
from tonus.config.schema.bus import SHIPPED
from tonus.config.schema.lab import LabScript
from tonus.runtime.words import axis_name, cell_name
from tonus.sim.errors import LabError
from tonus.sim.lab.engine import Lab
from tonus.tools.campaign.places import places
from tonus.tools.check.rules import check
from tonus.tools.cli.main import main
from tonus.tools.errors import ToolError
from tonus.tools.fieldbus.contract import violations
from tonus.tools.fieldbus.registry import KINDS, fieldbus_kind
from tonus.tools.log import open as open_log
from tonus.tools.run import fieldbuses
from tonus.tools.run.composer import Order
from tonus.tools.run.composer import run as carry_out

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "tutorials" / "your_fieldbus.md").read_text(encoding="utf-8")
BLOCKS = dict(re.findall(r'```\w+ title="(.+?)"\n(.*?)```', PAGE, re.DOTALL))
MODULE = BLOCKS["packets.py"]
INCLUDED = (
    "robots",
    "drives",
    *(f"{part}.yaml" for part in ("tracker", "tolerance", "control", "realtime", "lab")),
    *(f"{part}.yaml" for part in ("operation", "recording", "supervisor")),
)
SECTION = """\
kind: KIND
link: link0
axes: [0, 1, 2, 3, 4, 5, 6, 7]
cells: [0, 1, 2, 3, 4, 5, 6, 7, 8]
drive: !include ../drives/epos4.yaml
force_cell: !include force_cell.yaml
"""


class Mine:
    """A folder with the module `packets` on PYTHONPATH, and a configuration on it."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder, self._patch = folder, monkeypatch
        self.path = str(folder / "robot.yaml")
        monkeypatch.syspath_prepend(str(folder))
        self.write()
        for name in INCLUDED:
            (folder / name).symlink_to(ROOT / "config" / name)
        (folder / "buses").mkdir()
        (folder / "buses" / "force_cell.yaml").symlink_to(ROOT / "config/buses/force_cell.yaml")
        robot = (ROOT / "config" / "direct.yaml").read_text(encoding="utf-8")
        Path(self.path).write_text(robot.replace("buses/direct.yaml", "buses/packets.yaml"))
        self.section()

    def write(self, *edits: tuple[str, str]) -> None:
        """The module, with some of its text replaced."""
        text = MODULE
        for before, after in edits:
            assert text.count(before) == 1, before
            text = text.replace(before, after)
        (self.folder / "packets.py").write_text(text)
        self._patch.delitem(sys.modules, "packets", raising=False)

    def section(self, kind: str = "packets:PACKETS", more: str = "") -> None:
        text = SECTION.replace("KIND", kind) + more
        (self.folder / "buses" / "packets.yaml").write_text(text)

    def install(self, name: str) -> None:
        """As a distribution that registers the kind."""
        info = self.folder / "packets-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: packets\nVersion: 1.0\n")
        text = f"[tonus.fieldbuses]\n{name} = packets:PACKETS\n"
        (info / "entry_points.txt").write_text(text)

    def load(self, **overrides: Any) -> Config:
        return load(self.path, "hold", overrides)[0]


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Mine:
    folder = tmp_path / "mine"
    folder.mkdir()
    return Mine(folder, monkeypatch)


def tonus(line: str, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(sys, "argv", ["tonus", *line.split()])
    with pytest.raises(SystemExit) as ended:
        main()
    code = ended.value.code
    assert isinstance(code, int)
    return code


def run_line(mine: Mine, out: Path) -> str:
    quick = " ".join(f"--set {key}={value}" for key, value in QUICK.items())
    return f"run {mine.path} --virtual --scenario hold --duration 0.3 --out {out} {quick}"


# -- the whole way --------------------------------------------------------------------------------


@pytest.mark.wide
def test_it_is_run_logged_and_replayed_by_its_name(
    mine: Mine,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """And its own event is in the log; without its distribution the replay says what is missing."""
    mine.install("packets")
    mine.section("packets", "lose_every: 500\n")
    assert tonus(run_line(mine, tmp_path / "out"), monkeypatch) == 0
    assert "link0: 8 drives are configured" in capsys.readouterr().out
    log = open_log(tmp_path / "out" / "run.mcap")
    assert log["/tonus/state"]["state"].max() >= 5
    assert "kind: packets" in (log.config_text or "")
    lost = [event for event in log.events() if event.name == "packet_lost"]
    assert lost
    assert lost[0].where == "link0"
    assert lost[0].text == "no answer to the packet of tick 499; measurements age"
    assert set(log["/tonus/drives"]["age"][600:].ravel()) == {0, 1}
    assert tonus(f"log replay {log.path}", monkeypatch) == 0
    assert "bit-equal" in capsys.readouterr().out
    (mine.folder / "packets-1.0.dist-info" / "entry_points.txt").write_text("")
    assert tonus(f"log replay {log.path}", monkeypatch) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert "fieldbus: there is no packets; install the distribution that has this kind" in line


@pytest.mark.wide
def test_two_runs_of_one_seed_are_equal(mine: Mine, tmp_path: Path) -> None:
    bytes_of = []
    config, scenario = load(mine.path, "hold", QUICK)
    scenario = scenario.model_copy(update={"duration": 0.1})
    for name in ("first", "second"):
        order = Order(config, scenario, tmp_path / name, 1, True, lambda _: None, live=False)
        bytes_of.append(carry_out(order).log.read_bytes())
    assert bytes_of[0] == bytes_of[1]


def test_its_checks_are_rows_of_the_check(mine: Mine) -> None:
    config, scenario = load(mine.path)
    found = {finding.rule: finding for finding in check(config, scenario)}
    assert found["packet"].text == "an answer has 100 bytes"
    assert any("1 packets lost in a row" in each.text for each in check(config, scenario))
    mine.write(("size <= 1472", "size <= 99"))
    config, scenario = load(mine.path)
    assert [each.rule for each in check(config, scenario) if not each.ok] == ["packet"]


def test_its_nodes_have_names_everywhere(mine: Mine) -> None:
    config = mine.load()
    assert axis_name(config, 3) == "link0/4 (axis 3)"
    assert cell_name(config, 8) == "link0/109 (contact cell)"
    assert {"channel": "link0", "node": 4} in places(config, "drive")
    assert fieldbuses.channels(config) == []
    assert fieldbuses.pacing_name(config, virtual=True) == "virtual time"


def test_it_goes_through_text_with_its_own_keys(mine: Mine) -> None:
    """As a lab process, a log and a campaign hand a configuration on."""
    config = mine.load(**{"fieldbus.lose_every": 7})
    again = Config.model_validate(config.model_dump(mode="json"))
    assert again == config
    assert again.model_dump()["fieldbus"]["lose_every"] == 7


# -- refusals -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        ("packet", "fieldbus.kind: there is no 'packet'; choose one of 'canopen', 'direct', "),
        ("nowhere:PACKETS", "kind nowhere:PACKETS: cannot be imported: ModuleNotFoundError"),
        ("packets:PACKET", "cannot be imported: AttributeError"),
        ("packets:Station", "kind packets:Station: has no schema that is a subclass of"),
    ],
)
def test_a_kind_that_cannot_be_had_is_one_line(mine: Mine, kind: str, told: str) -> None:
    mine.section(kind)
    with pytest.raises(ConfigError) as refused:
        mine.load()
    line = str(refused.value)
    assert told in line
    if ":" in kind:
        assert line.endswith("; name a tonus.fieldbus.FieldbusKind in a module on PYTHONPATH")
    assert "\n" not in line
    assert "packets.yaml:1" in line or "robot.yaml" in line


def test_a_registered_kind_is_among_those_that_an_error_lists(mine: Mine) -> None:
    mine.install("post")
    mine.section("packet")
    with pytest.raises(ConfigError, match=r"'several', 'post' or package.module:Object"):
        mine.load()


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        ({"fieldbus.axes": [0, 1, 2, 3, 4, 5, 6]}, "fieldbus.nodes: no node for axis 7; add one"),
        ({"fieldbus.cells": [*range(10)]}, "fieldbus: .*cell 9"),
        ({"fieldbus.link": None}, "fieldbus.link: .*a text, not null"),
        ({"fieldbus.speed": 3}, "fieldbus.speed: is not a key here"),
    ],
)
def test_a_mistake_in_its_section_is_named_where_it_stands(
    mine: Mine, overrides: dict[str, Any], told: str
) -> None:
    with pytest.raises(ConfigError, match=told):
        mine.load(**overrides)


def test_a_lab_in_real_time_is_refused_in_one_line(
    mine: Mine,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(tmp_path / "runtime"))
    assert tonus(f"lab {mine.path}", monkeypatch) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.endswith("the lab emulates it in virtual time only; add --virtual")


def test_it_is_one_of_several_where_it_has_nodes(mine: Mine) -> None:
    ours = load(mine.path)[0].fieldbus.model_dump(mode="json") | {"axes": [], "cells": [8]}
    can = load("config/can.yaml")[0].fieldbus.model_dump(mode="json")
    can["channels"] = [
        each | {"force_cells": [cell for cell in each["force_cells"] if cell["cells"] != [8]]}
        for each in can["channels"]
    ]
    several = {"fieldbus": {"kind": "several", "buses": [can, ours]}}
    config, _ = load("config/can.yaml", None, several)
    assert [part.kind for part in config.fieldbus.parts] == ["canopen", "packets:PACKETS"]
    assert cell_name(config, 8) == "link0/109 (contact cell)"
    without = {"fieldbus": {"kind": "several", "buses": [can, ours | {"cells": []}]}}
    with pytest.raises(ConfigError, match=r"lists no nodes; it cannot be one of several"):
        load("config/can.yaml", None, without)


def test_without_an_emulation_there_is_no_lab(mine: Mine) -> None:
    mine.write((", emulate=emulate", ""))
    with pytest.raises(LabError, match=r"kind packets:PACKETS: has no emulation; remove the lab"):
        Lab(mine.load(), LabScript(), seed=1, clock=lambda: 0)


def test_what_is_no_registration_is_refused(mine: Mine) -> None:
    mine.write(("PACKETS = tf.FieldbusKind(PacketBus, build,", "PACKETS = build; build.schema = "
                "PacketBus\nOTHER = tf.FieldbusKind(PacketBus, build,"))  # fmt: skip
    with pytest.raises(ToolError, match=r"is not a tonus.fieldbus.FieldbusKind; make it one"):
        fieldbus_kind(mine.load().fieldbus)


# -- the contract ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["can", "direct", "ethercat", "mixed", "mixed_drives_ethercat"])
def test_every_shipped_kind_keeps_the_contract(name: str) -> None:
    assert violations(load(f"config/{name}.yaml")[0]) == []


def test_the_configurations_above_have_every_shipped_kind() -> None:
    kinds = {load(f"config/{name}.yaml")[0].fieldbus.kind for name in ("can", "direct", "ethercat")}
    assert kinds == set(KINDS) == set(SHIPPED) - {"several"}


def test_ours_keeps_the_contract(mine: Mine) -> None:
    assert violations(mine.load()) == []
    assert violations(mine.load(**{"fieldbus.lose_every": 7})) == []


@pytest.mark.parametrize(
    ("edit", "told"),
    [
        (("values.cell_tick[:] = sampled", "sampled"),
         "cell 0 has no fresh measurement within 50 ticks"),
        (("self.answer = tick, self", "self.answer = tick - 1, self"),
         "axis 0 is read 1 ticks late"),
        (("        self.commands = self.values.commands()", "        pass"),
         "AxisCommand.ENABLE does not enable every drive"),
        (("self.image, self.channels = image, (bus.link,)",
          "self.image, self.channels = tf.ProcessImage(8), (bus.link,)"),
         "image is not the one that it was built with"),
        (("        self.station.exchange(self.clock(), off)", "        pass"),
         "stop leaves the drives of axes [0, 1, 2, 3, 4, 5, 6, 7] enabled"),
        (("            raise tf.SdoError(f\"reading", "            raise OSError(f\"reading"),
         "sdo_read raises OSError, which is no DriverError"),
        (('progress(f"{self.channels[0]}: {self.cables} drives are configured")', "pass"),
         "start reports no progress in lines of text"),
        (("return self.events.take()", "return [tf.BusEvent('packet_lost', '', 'two\\nlines')]"),
         "event packet_lost has more than one line"),
        (("        controlwords, torques = self.commands\n",
          "        controlwords, torques = self.commands[0], [9] * count\n"),
         "a torque that is not finite is not 0 at axes [0, 1, 2, 3, 4, 5, 6, 7]"),
    ],
)  # fmt: skip
def test_the_contract_finds_what_breaks_it(mine: Mine, edit: tuple[str, str], told: str) -> None:
    mine.write(edit)
    found = violations(mine.load())
    assert told in found, found


# -- the sources ----------------------------------------------------------------------------------

_SECTIONS = {"CanopenBus", "DirectBus", "EthercatBus", "SeveralBuses"}
_OWN_KIND = {
    "drivers/canopen/master.py": {"CanopenBus"},
    "drivers/direct.py": {"DirectBus"},
    "drivers/ethercat/master.py": {"EthercatBus"},
    "drivers/several.py": {"SeveralBuses"},
    "runtime/supervisor/wiring.py": {"CanopenBus"},
    "tools/safety/budget.py": {"CanopenBus", "EthercatBus"},
}
"""A driver that is given another kind's section says so; the supervisor reads CANopen's frames by
itself, and no other's; the times of a safety page are those of two shipped configurations."""


def _asked(path: Path) -> set[str]:
    """The kinds of fieldbuses that a file asks about with `isinstance`."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    calls = (node for node in ast.walk(tree) if isinstance(node, ast.Call))
    asking = [c for c in calls if isinstance(c.func, ast.Name) and c.func.id == "isinstance"]
    names = (n.id for call in asking for n in ast.walk(call) if isinstance(n, ast.Name))
    return _SECTIONS & set(names)


def test_nothing_asks_for_a_kind_outside_the_registry() -> None:
    found = {}
    for room in ("config", "drivers", "runtime", "sim", "tools"):
        for path in (ROOT / room).rglob("*.py"):
            if kinds := _asked(path):
                found[path.relative_to(ROOT).as_posix()] = kinds
    assert found == _OWN_KIND
