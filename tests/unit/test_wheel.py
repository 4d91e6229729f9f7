"""The wheel works installed, outside the checkout."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that holds only what the wheel brings."""
    built, target = tmp_path_factory.mktemp("dist"), tmp_path_factory.mktemp("site")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(built)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = built.glob("*.whl")
    install = [sys.executable, "-m", "pip", "install", "--no-deps", "--no-index", "--target"]
    subprocess.run([*install, str(target), str(wheel)], check=True, capture_output=True)
    return target


def _run(installed: Path, somewhere: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(installed)}
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=somewhere,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_packages_come_from_the_wheel(installed: Path, tmp_path: Path) -> None:
    code = "from tonus import config, tools\nprint(config.__file__, tools.__file__)"
    result = _run(installed, tmp_path, "-c", code)
    assert result.returncode == 0, result.stderr
    assert result.stdout.count(str(installed)) == 2


def test_the_command_finds_its_configurations(installed: Path, tmp_path: Path) -> None:
    result = _run(installed, tmp_path, str(installed / "bin" / "tonus"), "check", "config/can.yaml")
    assert result.returncode == 0, result.stdout + result.stderr


def test_the_wheel_brings_no_tests(installed: Path) -> None:
    assert not (installed / "tests").exists()
    assert (installed / "config" / "scenarios" / "load_test.yaml").is_file()
