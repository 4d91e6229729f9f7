"""What the viewer's first picture waits for, and what comes after it."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from websockets.sync.client import connect
from websockets.typing import Origin

from tonus.config.errors import ConfigError
from tonus.config.loader import HERE, load
from tonus.runtime.recording.payloads import EVENT
from tonus.runtime.recording.ring import RingWriter
from tonus.runtime.signals import SCHEMA_VERSION, cycle_dtype
from tonus.runtime.states import Fault
from tonus.runtime.timing import clock
from tonus.runtime.words import TEXT
from tonus.tools.errors import ToolError
from tonus.tools.run.description import Description, describe_run
from tonus.tools.view import settings as settings_module
from tonus.tools.view import viewer as viewer_module
from tonus.tools.view.gate import Gate
from tonus.tools.view.live import Live
from tonus.tools.view.moment import Moment
from tonus.tools.view.playback import Playback
from tonus.tools.view.recorded import Recorded
from tonus.tools.view.settings import held_against_its_schema, settings
from tonus.tools.view.shape import Plane, Shape
from tonus.tools.view.viewer import Viewer
from tonus.tools.view.words import state_of

GOLDEN = Path(__file__).resolve().parents[1] / f"replay/golden/v{SCHEMA_VERSION}.mcap"
COMPLETE = sorted(file for file in HERE.glob("*.yaml") if "\nfieldbus:" in file.read_text())
"""configurations that no other one includes"""


@pytest.mark.parametrize("file", COMPLETE, ids=lambda file: file.stem)
def test_a_picture_takes_from_a_configuration_what_the_whole_of_it_says(file: Path) -> None:
    config, scenario = load(file, "contact")
    written = (
        yaml.safe_load(yaml.safe_dump(each.model_dump(mode="json"))) for each in (config, scenario)
    )
    shape = Shape.of(*written)
    robot, tension = config.robot, config.control.tension
    assert shape.cables == robot.cables
    assert np.array_equal(shape.frame, robot.geometry.frame)
    assert np.array_equal(shape.platform, robot.geometry.platform)
    assert np.array_equal(shape.drum_radius, robot.drum_radius)
    box = robot.workspace
    assert np.array_equal(shape.workspace, [box.x, box.y, box.z])
    assert np.array_equal(shape.home, robot.home)
    assert np.array_equal(shape.rest, robot.rest)
    assert shape.levels == (tension.slack, tension.min, tension.pre, tension.max)
    assert shape.period == config.control.rates.period
    assert shape.in_lab == (config.lab is not None)
    assert scenario.lab.phantom is not None
    assert shape.phantom == Plane(scenario.lab.phantom.point, scenario.lab.phantom.normal)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("robot", None),
        ("robot", []),
        ("robot.geometry.frame", [[0.0, 0.0, 0.0]] * 1000),
        ("robot.geometry.frame", [[0.0, 0.0]] * 8),
        ("robot.geometry.platform", [[0.0, 0.0, float("nan")]] * 8),
        ("robot.drum.radius", None),
        ("robot.axes", {"1": {"drum": {"radius": "wide"}}}),
        ("robot.workspace.x", [0.0]),
        ("robot.home", "here"),
        ("control.tension.min", {}),
        ("control.rates.period_us", 0),
    ],
)
def test_what_cannot_be_drawn_is_refused(key: str, value: object) -> None:
    """Each of these is what `Live` and `Recorded` take for another version's configuration."""
    config = load("config/can.yaml")[0].model_dump(mode="json")
    *path, name = key.split(".")
    place = config
    for part in path:
        place = place[part]
    place[name] = value
    with pytest.raises((LookupError, TypeError, ValueError)):
        Shape.of(config, None)


def test_the_viewers_own_settings_are_held_against_their_schema(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are read without it, for the first picture; what is wrong is told all the same."""
    text = settings_module._FILE.read_text()
    assert vars(settings()) == held_against_its_schema().model_dump()
    changed = {
        "rate_hz: 30.0": "rate_hz: often",
        "clients: 16": "clients: true",
        "port: 8090": "prt: 8090",
        "window_s: 30.0": "window_s: -1.0",
    }
    for number, (before, after) in enumerate(changed.items()):
        assert before in text
        file = tmp_path / f"{number}.yaml"
        file.write_text(text.replace(before, after))
        monkeypatch.setattr(settings_module, "_FILE", file)
        settings.cache_clear()
        with pytest.raises(ConfigError, match=r"config/view\.yaml:\d+"):
            _ = settings().port, held_against_its_schema()
    settings.cache_clear()


def test_a_scenario_that_cannot_be_read_costs_the_phantom_only() -> None:
    config = load("config/direct.yaml")[0].model_dump(mode="json")
    for scenario in (None, "text", {}, {"lab": None}, {"lab": {"phantom": {"point": [1]}}}):
        assert Shape.of(config, scenario).phantom is None


def test_a_first_picture_waits_for_neither_schema_nor_scipy_nor_compiler() -> None:
    """They take longer to load than all that it needs."""
    code = """
import sys
from tonus.tools.cli import view
assert "numpy" not in sys.modules  # its threads are bounded before it is loaded
from tonus.tools.view import gate, live, viewer
heavy = {"scipy", "numba", "mcap", "pydantic", "viser", "tonus.config.loader"}
assert not heavy & set(sys.modules), heavy & set(sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("alone", [True, False])
def test_all_else_is_loaded_when_a_page_has_its_first_picture(
    monkeypatch: pytest.MonkeyPatch, *, alone: bool
) -> None:
    """It would take the processor from the first picture; without a page it is loaded as well."""
    monkeypatch.setattr(viewer_module, "_ALONE_S", 0.1 if alone else 1e6)
    gate = Gate("127.0.0.1", 0, None)
    viewer = Viewer(gate, None, Playback([Recorded(GOLDEN)]))
    running = threading.Thread(target=viewer.run)
    running.start()
    try:
        _until(lambda: viewer._pictures > 10)
        if alone:
            _until(lambda: viewer._panels is not None)
            return
        assert viewer._loading.ident is None
        origin = f"http://127.0.0.1:{gate.port}"
        with connect(f"ws://127.0.0.1:{gate.port}/channel", origin=Origin(origin)) as page:
            kinds = [json.loads(page.recv(20.0))["kind"]]
            while kinds[-1] != "hello":
                kinds.append(json.loads(page.recv(20.0))["kind"])
        assert kinds[0] == "now"
    finally:
        viewer.close()
        running.join()
        viewer.release()


def _until(condition: Callable[[], bool]) -> None:
    for _ in range(2000):
        if condition():
            return
        clock.pause(0.01)
    raise AssertionError("it did not happen")


def test_a_fault_has_its_place_as_soon_as_the_configuration_is_known() -> None:
    config = load("config/can.yaml")[0]
    record = np.zeros(1, cycle_dtype(config.robot.cables))
    record["state"]["fault"], record["state"]["fault_where"] = Fault.DRIVE_LOST, 3
    early, late = (state_of(each, record)["fault"] for each in (None, config))
    assert early["text"] == TEXT[Fault.DRIVE_LOST]
    assert early["remedy"] == late["remedy"]
    assert late["text"].endswith(early["text"])
    assert "axis 3" in late["text"]


def test_a_log_whose_configuration_is_of_another_version_is_refused_in_a_line() -> None:
    """Also where only that part of it is, which no picture needs."""
    log = Recorded(GOLDEN)
    log._document["control"]["gain_of_tomorrow"] = 1.0
    with pytest.raises(ToolError, match="the version that recorded it"):
        _ = log.config
    log.close()


def test_a_live_run_shows_its_newest_record_first_and_then_what_plots_need(tmp_path: Path) -> None:
    """A picture does not wait for 30 s of records to be read."""
    config, scenario = load("config/direct.yaml", "hold")
    texts = [yaml.safe_dump(each.model_dump(mode="json")) for each in (config, scenario)]
    describe_run(tmp_path, Description(*texts, "", "name", True, True, None, "run.mcap"))
    record = np.zeros(1, cycle_dtype(config.robot.cables))
    cycles = RingWriter.create(tmp_path / "cycle.ring", record.nbytes, 1000, {})
    events = RingWriter.create(tmp_path / "events.ring", EVENT.itemsize, 10, {})

    def publish(ticks: range) -> None:
        for tick in ticks:
            record["timing"]["tick"] = tick
            cycles.publish(record.tobytes(), tick)

    def ticks(moment: Moment) -> list[int]:
        return [int(tick) for tick in moment.samples.rows["timing"]["tick"]]

    publish(range(401))
    live = Live(tmp_path)
    publish(range(401, 405))
    first = live.advance()
    assert first.newest["timing"]["tick"] == 404
    assert ticks(first) == [400]
    assert not first.jumped
    second = live.advance()
    assert second.jumped
    assert ticks(second) == list(range(0, 401, 20))
    publish(range(405, 450))
    third = live.advance()
    assert not third.jumped
    assert ticks(third) == [420, 440]
    live.close()
    cycles.close()
    events.close()
