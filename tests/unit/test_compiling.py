"""Compiled code is kept somewhere, and a person is told what takes so long."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tonus.tools.cli import compiling
from tonus.tools.cli.main import main


@pytest.fixture
def nowhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A user who may write to neither of the usual places."""
    (tmp_path / "file").write_text("")
    monkeypatch.delenv(compiling.VARIABLE, raising=False)
    monkeypatch.setattr(compiling, "_usual", lambda: [tmp_path / "file" / "cache"])
    monkeypatch.setattr(compiling.tempfile, "gettempdir", lambda: str(tmp_path / "tmp"))
    return tmp_path / "tmp"


def test_who_may_write_nowhere_usual_gets_a_folder_of_their_own(nowhere: Path) -> None:
    nowhere.mkdir()
    compiling.keep_somewhere()
    folder = Path(os.environ.pop(compiling.VARIABLE))
    assert folder.parent == nowhere
    assert folder.stat().st_mode & 0o777 == 0o700


def test_a_folder_that_is_somebody_elses_is_not_used(nowhere: Path) -> None:
    nowhere.mkdir()
    (nowhere / "elsewhere").mkdir()
    (nowhere / f"tonus-compiled-{os.getuid()}").symlink_to(nowhere / "elsewhere")
    compiling.keep_somewhere()
    assert compiling.VARIABLE not in os.environ


def test_without_any_place_it_is_left_to_numba_to_say_so(nowhere: Path) -> None:
    compiling.keep_somewhere()
    assert compiling.VARIABLE not in os.environ


def test_usual_places_are_taken_first(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(compiling.VARIABLE, raising=False)
    monkeypatch.setattr(compiling, "_usual", lambda: [tmp_path / "cache"])
    compiling.keep_somewhere()
    assert compiling.VARIABLE not in os.environ


def test_a_long_compilation_is_told_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    times = iter((0.0, 2.0, 3.0, 8.0))
    monkeypatch.setattr(compiling, "wall_seconds", lambda: next(times))
    told = compiling.Compiling()

    def kernel() -> None: ...

    begins = SimpleNamespace(is_start=True, data={"dispatcher": SimpleNamespace(py_func=kernel)})
    told.notify(begins)
    assert capsys.readouterr().err == "", "a short one is nobody's concern"
    for _ in range(3):
        told.notify(begins)
    first, second = capsys.readouterr().err.splitlines()
    assert "once for each installation" in first
    assert first.endswith(".kernel, number 2")
    assert second.startswith("compiling: ")
    assert second.endswith(".kernel, number 4")


@pytest.mark.parametrize("arguments", [("log", "info", "nope.mcap"), ("check", "nope.yaml")])
def test_every_command_keeps_compiled_code_somewhere_and_tells(
    nowhere: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
) -> None:
    """Also one that computes nothing: its imports need numba's cache."""
    nowhere.mkdir()
    listeners: list[tuple[str, Any]] = []
    monkeypatch.setattr("numba.core.event.register", lambda *each: listeners.append(each))
    monkeypatch.setattr(sys, "argv", ["tonus", *arguments])
    with pytest.raises(SystemExit):
        main()
    assert Path(os.environ.pop(compiling.VARIABLE)).parent == nowhere
    ((kind, listener),) = listeners
    assert kind == "numba:compile"
    times = iter((0.0, 2.0))
    monkeypatch.setattr(compiling, "wall_seconds", lambda: next(times))
    capsys.readouterr()
    for _ in range(2):
        listener.on_start(SimpleNamespace(is_start=True, data={}))
    assert capsys.readouterr().err.startswith("compiling (once for each installation")
