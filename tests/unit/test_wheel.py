"""The wheel works beside a project that has modules of the same names as its rooms."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("config", "drivers", "runtime", "sim", "tools")
OF_THE_PROJECT = """\
import can
import config
import drivers
import pytest
import runtime
import sim
import tools
import tonus
from pathlib import Path

HERE = Path(__file__).resolve().parent


def test_the_projects_own_modules_are_its_own():
    for module in (config, drivers, runtime, sim, tools):
        assert HERE in Path(module.__file__).parents
        assert module.OWNER == "the project"


def test_tonus_has_its_own():
    from tonus import tools as theirs
    from tonus.config.loader import HERE as shipped

    assert HERE not in Path(theirs.__file__).parents
    settings, scenario = tonus.load("config/can.yaml")
    assert settings.name == "can"
    assert scenario.name == "load_test"
    assert (shipped / "can.yaml").is_file()


def test_python_can_finds_the_lab_by_its_entry_point():
    with pytest.raises(can.CanInitializationError, match="tonus lab"):
        can.Bus(interface="tonus", channel="can0")
"""


class Installed(NamedTuple):
    wheel: Path
    sdist: Path
    python: Path
    """of an environment with the wheel, which also sees the packages of this one"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    built, home = tmp_path_factory.mktemp("dist"), tmp_path_factory.mktemp("environment")
    _run(sys.executable, "-m", "hatchling", "build", "-d", str(built), folder=ROOT)
    (wheel,), (sdist,) = built.glob("*.whl"), built.glob("*.tar.gz")
    _run(sys.executable, "-m", "venv", "--without-pip", str(home), folder=built)
    python = home / "bin" / "python"
    (packages,) = home.glob("lib/python*/site-packages")
    # A line of a .pth file adds a folder, and not what that folder's own .pth files name: the
    # editable install of this checkout stays out.
    (packages / "ours.pth").write_text(sysconfig.get_path("purelib") + "\n")
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet"]
    options = ["--no-deps", "--no-index", "--ignore-installed", "--disable-pip-version-check"]
    _run(*pip, *options, str(wheel), folder=built)
    return Installed(wheel, sdist, python)


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A project that has every name for itself."""
    own = 'OWNER = "the project"\n'
    (tmp_path / "config.py").write_text(own)
    for room in ROOMS[1:]:
        (tmp_path / room).mkdir()
        (tmp_path / room / "__init__.py").write_text(own)
    (tmp_path / "test_project.py").write_text(OF_THE_PROJECT)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    return tmp_path


def _run(*command: str, folder: Path) -> str:
    """What a command prints; it must end well."""
    bare = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    bare["TONUS_RUNTIME_DIR"] = str(folder / "empty")
    done = subprocess.run(
        command, cwd=folder, env=bare, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_wheel_brings_one_name(installed: Installed) -> None:
    with zipfile.ZipFile(installed.wheel) as wheel:
        names = wheel.namelist()
    (about,) = {name.split("/")[0] for name in names} - {"tonus"}
    assert about.startswith("tonus-")
    assert about.endswith(".dist-info")
    assert len(names) == len(set(names))
    for room in ROOMS:
        for file in (ROOT / room).rglob("*"):
            if file.is_file() and file.suffix in (".py", ".yaml", ".eds", ".service"):
                assert f"tonus/{file.relative_to(ROOT)}" in names


def test_the_source_distribution_holds_the_same_files(installed: Installed) -> None:
    with zipfile.ZipFile(installed.wheel) as wheel:
        shipped = {name for name in wheel.namelist() if name.startswith("tonus/")}
    with tarfile.open(installed.sdist) as sdist:
        members = sdist.getmembers()
    assert all(member.isfile() for member in members), "a link would point to nothing"
    inside = {member.name.partition("/")[2] for member in members}
    assert {name for name in inside if name.startswith("tonus/")} == shipped


@pytest.mark.parametrize("as_module", [True, False], ids=["python -m pytest", "pytest"])
def test_a_project_with_the_same_names_is_tested(
    installed: Installed, project: Path, *, as_module: bool
) -> None:
    script = ["-m", "pytest"] if as_module else [str(Path(sysconfig.get_path("scripts"), "pytest"))]
    told = _run(str(installed.python), *script, "-p", "no:cacheprovider", folder=project)
    assert "3 passed" in told


def test_the_command_works_there(installed: Installed, project: Path) -> None:
    told = _run(
        str(installed.python.with_name("tonus")), "check", "config/direct.yaml", folder=project
    )
    assert "direct" in told
    code = "import tonus.tools.cli.main as main; print(main.__file__)"
    assert str(installed.python.parents[1]) in _run(
        str(installed.python), "-c", code, folder=project
    )
