"""A log as a .mat file: what MATLAB, Octave and scipy find in it is what the log holds."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.io import loadmat
from synthetic_run import MS, record

from tests import mat_file
from tonus.runtime.states import Fault, State
from tonus.tools.cli.log import log as command
from tonus.tools.errors import ToolError
from tonus.tools.log import Log, matlab
from tonus.tools.log import open as open_log
from tonus.tools.log.decode import Column
from tonus.tools.log.export import export, export_merged
from tonus.tools.log.matlab import Matlab, legal
from tonus.tools.log.tables import Signal

TICKS = 300


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    return open_log(record(tmp_path_factory.mktemp("log"), TICKS, chunk_ms=50))


@pytest.fixture(scope="module")
def written(log: Log, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("mat")
    told = CliRunner().invoke(
        command, ["export", str(log.path), "--format", "mat", "--out", str(out)]
    )
    assert told.exit_code == 0, told.output
    assert [path.name for path in out.iterdir()] == ["run.mat"]
    return out / "run.mat"


def test_every_number_comes_back_by_scipy_and_by_the_format_s_own_words(
    log: Log, written: Path
) -> None:
    theirs = loadmat(written, struct_as_record=False, squeeze_me=False)
    ours = mat_file.read(written)
    checked = 0
    for topic in log.topics:
        rows, name = log[topic], topic.strip("/").replace("/", "_")
        if rows.dtype.names is None or topic == "/tonus/keyframe":
            assert name not in ours
            continue
        for field in rows.dtype.names:
            if rows.dtype[field].hasobject:
                continue
            expected = rows[field].reshape(len(rows), -1)
            found = getattr(theirs[name][0, 0], field)
            assert np.array_equal(found, expected), f"{topic} {field}"
            if rows.dtype[field].base.kind != "b":  # MATLAB's logical is a uint8 with a flag
                assert found.dtype == rows.dtype[field].base
            assert np.array_equal(ours[name][field].value, expected), f"{topic} {field}"
            checked += 1
    assert checked > 100


def test_a_struct_has_the_time_and_the_units(log: Log, written: Path) -> None:
    tension = mat_file.read(written)["tonus_tension"]
    assert tension["time"].shape == (TICKS, 1)
    assert tension["time"].value[:, 0].tolist() == [k * MS * 1e-9 for k in range(TICKS)]
    assert tension["units"]["measured"].text == "N"
    assert tension["units"]["time"].text == "s"
    assert "solver" not in tension["units"].value


def test_names_stand_beside_the_numbers(log: Log, written: Path) -> None:
    """A row of characters each, with blanks behind, as MATLAB's cellstr and strtrim want it."""
    state = mat_file.read(written)["tonus_state"]
    assert (state["state"].kind, state["state_name"].kind) == ("uint8", "char")
    told = ["".join(row).rstrip() for row in state["state_name"].value.tolist()]
    assert told == [State(int(number)).name for number in log["/tonus/state"]["state"]]
    faults = ["".join(row).rstrip() for row in state["fault_name"].value.tolist()]
    assert set(faults) == {"none", Fault.CONTACT_LIMIT.name.lower()}
    assert "\0" not in "".join(state["state_name"].value.ravel().tolist())
    read = loadmat(written, squeeze_me=True, struct_as_record=False)["tonus_state"].state_name
    assert [name.rstrip() for name in read] == told


def test_names_of_eight_axes_are_eight_a_tick(written: Path) -> None:
    drives = mat_file.read(written)["tonus_drives"]
    count, axes, width = drives["state_name"].shape
    assert (count, axes) == (TICKS, 8)
    assert "".join(drives["state_name"].value[7, 3].tolist()) == "lost".ljust(width)


def test_texts_of_any_length_are_cells(log: Log, written: Path) -> None:
    events = mat_file.read(written)["tonus_events"]
    assert events["text"].kind == "cell"
    assert [each.text for each in events["text"].value] == [each.text for each in log.events()]
    read = loadmat(written, squeeze_me=True, struct_as_record=False)["tonus_events"]
    assert read.text.tolist() == [each.text for each in log.events()]
    assert {name.rstrip() for name in read.level_name} == {"info"}


def test_the_file_tells_where_it_comes_from(log: Log, written: Path) -> None:
    about = mat_file.read(written)["about"]
    assert about["scenario"].text == "synthetic"
    assert about["file"].text == "run.mcap"


@pytest.mark.parametrize(
    ("name", "allowed"),
    [
        ("tonus_tension", "tonus_tension"),
        ("can/can0", "can_can0"),
        ("_hidden", "hidden"),
        ("2nd", "x2nd"),
        ("end", "xend"),
        ("größe", "gr__e"),
        ("", "x"),
        ("a" * 70, "a" * 63),
    ],
)
def test_names_are_legal_in_matlab(name: str, allowed: str) -> None:
    assert legal(name) == allowed


def test_names_that_become_equal_are_told_apart() -> None:
    assert legal("a.b", ["a_b"]) == "a_b_2"
    assert legal("a" * 70, ["a" * 63]) == "a" * 61 + "_2"


def test_fields_of_others_are_not_lost(tmp_path: Path) -> None:
    """scipy leaves out what begins with an underscore, and says so in a warning only."""
    path = tmp_path / "x.mat"
    file = Matlab(path, Path("run.mcap"))
    for _ in range(2):
        file.add("for", [Signal("_x", "m", np.arange(3.0)), Signal("x", "", np.arange(3))])
    file.write({})
    file.close()
    found = mat_file.read(path)["xfor"]
    assert found["x"].value[:, 0].tolist() == [0.0, 1.0, 2.0, 0.0, 1.0, 2.0]
    assert found["x_2"].value[:, 0].tolist() == [0, 1, 2, 0, 1, 2]


def test_a_variable_that_matlab_could_not_read_is_refused(
    log: Log, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(matlab, "LARGEST", (1 << 20) + 10_000)
    with pytest.raises(ToolError, match=r"2 GB.*--format parquet"):
        export(log, tmp_path / "new", "mat")
    assert not (tmp_path / "new").exists()


def test_a_topic_that_changes_within_a_run_is_refused(
    log: Log, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As that of files of two robots would."""
    rows = [np.zeros(2, [("a", "<f8", (size,))]) for size in (8, 6)]
    times = np.arange(2)
    (topic, *_) = log.topics
    parts = [{topic: Column(each, times, times)} for each in rows]
    monkeypatch.setattr(log, "batches", lambda _topics: iter(parts))
    with pytest.raises(ToolError, match="not the same in all of the run"):
        export(log, tmp_path / "new", "mat", [topic])
    assert not (tmp_path / "new").exists()


def peak(log: Log, out: Path, kind: str, merged: bool) -> int:
    tracemalloc.start()
    try:
        if merged:
            export_merged(log, out, kind)
        else:
            export(log, out, kind)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.wide
@pytest.mark.parametrize("merged", [False, True], ids=["apart", "merged"])
@pytest.mark.parametrize(("kind", "growth"), [("csv", 150.0), ("mat", 700.0)])
def test_memory_does_not_hold_the_log(
    tmp_path: Path, kind: str, growth: float, merged: bool
) -> None:
    """Bytes a tick of a longer log: next to none but the places of its chunks, and of a .mat file
    those of the longest field, the names of the axes' states; all fields take 2900."""
    counts = (300, 1500)
    peaks = []
    for count in counts:
        folder = tmp_path / str(count)
        log = open_log(record(folder, count, chunk_ms=50, raw_frames=False))
        peaks.append(peak(log, tmp_path / f"out{count}", kind, merged))
    assert (peaks[1] - peaks[0]) / (counts[1] - counts[0]) < growth
