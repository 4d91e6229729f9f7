"""Where sockets and rings lie."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tonus.config import places


@pytest.fixture(autouse=True)
def bare(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TONUS_RUNTIME_DIR", raising=False)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)


@pytest.mark.parametrize(
    ("run", "shared", "chosen"),
    [
        ("tmpfs", "tmpfs", "/run/tonus"),
        ("ext4", "tmpfs", f"/dev/shm/tonus-{os.getuid()}"),  # noqa: S108
        ("ext4", "unknown", "/run/tonus"),
    ],
)
def test_rings_lie_in_memory_where_there_is_a_choice(
    run: str, shared: str, chosen: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    kinds = {"/run/tonus": run, "/dev/shm": shared}  # noqa: S108
    monkeypatch.setattr(places, "file_system", lambda path: kinds[str(path)])
    assert places.runtime_dir() == Path(chosen)


def test_the_environment_has_the_last_word(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/somewhere")
    assert places.runtime_dir() == Path("/somewhere/tonus")
    monkeypatch.setenv("TONUS_RUNTIME_DIR", "/elsewhere")
    assert places.runtime_dir() == Path("/elsewhere")


def test_a_file_system_is_that_of_the_nearest_mount_point() -> None:
    assert places.file_system(Path("/proc/self")) == "proc"
    assert places.file_system(Path("/proc/not/there")) == "proc"
