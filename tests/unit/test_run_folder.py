"""Where a run writes: nothing that an earlier run recorded is ever lost."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.composed import configured, virtual
from tests.scripted import scripted
from tonus.drivers.errors import DriverError
from tonus.runtime.daemon import Daemon
from tonus.tools.errors import ToolError
from tonus.tools.run.run_folder import RunFolder, new_folder, next_folder


def written(folder: Path, text: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("run.mcap", "run.2.mcap", "summary.json", "overview.png"):
        (folder / name).write_text(text)


def names(folder: Path) -> list[str]:
    return sorted(each.name for each in folder.iterdir())


def test_each_run_has_a_folder_of_its_own_named_by_time_and_what_it_is(tmp_path: Path) -> None:
    first, second = (new_folder(Path("a/my robot.yaml"), "x/y.yaml", tmp_path) for _ in range(2))
    assert first != second
    assert re.fullmatch(r"\d{8}-\d{6}-my_robot-x_y.yaml(-2)?", first.name)


def test_latest_points_to_the_run_that_started_last(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        folder = RunFolder(tmp_path / name, link=True)
        with folder.occupied():
            folder.started()
    with RunFolder(tmp_path / "c", link=True).occupied():
        pass
    assert (tmp_path / "latest").readlink() == Path("b")
    assert names(tmp_path) == ["a", "b", "latest"], "a folder in which nothing is leaves no trace"


def test_something_else_of_that_name_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "latest").mkdir()
    folder = RunFolder(tmp_path / "a", link=True)
    with folder.occupied():
        folder.started()
    assert not (tmp_path / "latest").is_symlink()


def test_an_earlier_run_moves_aside_and_what_is_not_a_runs_stays(tmp_path: Path) -> None:
    for number in range(3):
        folder = RunFolder(tmp_path, link=False)
        with folder.occupied():
            folder.started()
            written(tmp_path, f"run {number}")
            (tmp_path / "notes.txt").write_text("mine")
    assert names(tmp_path / "previous") == ["0001", "0002"]
    for number, place in enumerate(("previous/0001", "previous/0002", ".")):
        assert (tmp_path / place / "run.2.mcap").read_text() == f"run {number}"
        assert (tmp_path / place / "summary.json").read_text() == f"run {number}"
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_start_that_fails_leaves_the_earlier_run_in_its_place(tmp_path: Path) -> None:
    written(tmp_path, "old")

    def fail() -> None:
        with RunFolder(tmp_path, link=False).occupied():
            assert not (tmp_path / "run.mcap").exists()
            (tmp_path / "run.mcap").write_text("of the start that failed")
            raise DriverError("no answer")

    with pytest.raises(DriverError):
        fail()
    assert (tmp_path / "run.mcap").read_text() == "old"
    assert (tmp_path / "failed/0001/run.mcap").read_text() == "of the start that failed"
    assert names(tmp_path) == sorted(
        [*("failed", "overview.png", "run.2.mcap"), *("run.mcap", "summary.json")]
    )


def test_numbered_folders_count_on(tmp_path: Path) -> None:
    assert next_folder(tmp_path).name == "0001"
    for name in ("0007", "0003", "20261122-120000-can-hold", "notes"):
        (tmp_path / name).mkdir()
    assert next_folder(tmp_path).name == "0008"


def test_a_bring_up_that_fails_costs_no_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The whole of it: a run, then one whose bus does not come up, into the same folder."""
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(tmp_path / "runtime"))
    out = tmp_path / "out"
    config, _ = configured("config/direct.yaml")
    scenario = scripted(operator=[{"at": 0.3, "command": "stop"}])
    virtual(config, scenario, out)
    before = (out / "run.mcap").read_bytes()

    async def refuse(*_: object, **__: object) -> None:
        raise DriverError("can0/1: no answer")

    with monkeypatch.context() as patched:
        patched.setattr(Daemon, "run", refuse)
        with pytest.raises(DriverError):
            virtual(config, scenario, out)
    assert (out / "run.mcap").read_bytes() == before
    virtual(config, scenario, out)
    assert (out / "previous/0001/run.mcap").read_bytes() == before
    assert (out / "run.mcap").read_bytes() == before, "where a run writes is not in its log"


def test_a_folder_that_cannot_take_the_earlier_run_is_named(tmp_path: Path) -> None:
    written(tmp_path, "old")
    (tmp_path / "previous").write_text("a file")
    with (
        pytest.raises(ToolError, match="earlier run cannot be moved"),
        RunFolder(tmp_path, link=False).occupied(),
    ):
        pass
    assert (tmp_path / "run.mcap").read_text() == "old"
