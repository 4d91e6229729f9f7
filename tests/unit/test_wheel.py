"""The wheel works beside a project that has modules of the same names as its rooms; and in one that
has the examples of docs/hil_examples.md for its tests.

Of these `make test-wide` plays two seeds instead of 50, serially and on two processes with the same
logs; `make test-long` what stands there. The one in real time is a test of its own.
"""

from __future__ import annotations

import re
import shutil
import sysconfig
import tarfile
import zipfile
from hashlib import sha256
from pathlib import Path

import pytest
from markdown_it import MarkdownIt

from tests.foreign import pytest_in
from tests.wheel import ROOT, Installed, build
from tonus.runtime.signals import SCHEMA_VERSION

pytestmark = pytest.mark.wide

PAGE = ROOT / "docs" / "hil_examples.md"
GOLDEN = ROOT / "tests" / "replay" / "golden" / f"v{SCHEMA_VERSION}.mcap"
REAL_TIME = "test_latency.py"
SHORT = ("tonus_seeds(50)", "tonus_seeds(2)")
LOST_FRAMES = "test_lost_frames.py"
ETHERCAT = """\
import pytest


@pytest.mark.tonus(config="config/ethercat.yaml")
@pytest.mark.tonus_expect("*")
def test_a_slave_without_power_is_found(tonus_held):
    robot = tonus_held()
    robot.fault("unplug", channel="tonus0", node=3)
    robot.advance(20)
    run = robot.end()
    run.expect("slave_silent", where="tonus0/4", within=0.01)  # and all behind it
    run.replays()
"""
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


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    return build(tmp_path_factory.mktemp("dist"), tmp_path_factory.mktemp("environment"))


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
    told = installed.do(str(installed.python), *script, "-p", "no:cacheprovider", folder=project)
    assert "3 passed" in told


def test_the_command_works_there(installed: Installed, project: Path) -> None:
    told = installed.do(
        str(installed.python.with_name("tonus")), "check", "config/direct.yaml", folder=project
    )
    assert "direct" in told
    code = "import tonus.tools.cli.main as main; print(main.__file__)"
    assert str(installed.python.parents[1]) in installed.do(
        str(installed.python), "-c", code, folder=project
    )


def files() -> dict[str, str]:
    """The page's files, by name."""
    found = {}
    for token in MarkdownIt().parse(PAGE.read_text(encoding="utf-8")):
        title = re.search(r'title="(.+?)"', token.info) if token.type == "fence" else None
        if title:
            found[title[1]] = token.content
    return found


@pytest.fixture
def foreign(installed: Installed, tmp_path: Path) -> Path:
    for name, text in files().items():
        if name != REAL_TIME:
            (tmp_path / name).write_text(text)
    shutil.copyfile(GOLDEN, tmp_path / "field.mcap")
    (tmp_path / "test_ethercat.py").write_text(ETHERCAT)
    return tmp_path


def figures(text: str) -> list[str]:
    """The measured ones, with their tests."""
    table = text.partition("Tonus: measured")[2].partition("=\n")[2].partition("\n=")[0]
    return sorted(table.splitlines())


def logs(out: Path) -> dict[str, str]:
    """Digest of each log that was kept, by its place in the folder."""
    return {
        str(log.relative_to(out)): sha256(log.read_bytes()).hexdigest()
        for log in out.rglob("*.mcap")
    }


def test_the_page_has_eight_examples() -> None:
    assert len(files()) == 8


def test_the_examples_pass(installed: Installed, foreign: Path) -> None:
    lost, python = foreign / LOST_FRAMES, str(installed.python)
    lost.write_text(lost.read_text().replace(*SHORT))
    kept = ("--tonus-keep=all", "--tonus-out")
    text, code = pytest_in(foreign, "-n2", "--tonus-durations", *kept, "parallel", python=python)
    assert code == 0, text
    assert "12 passed" in text, text
    assert len(figures(text)) == 5, text
    serial, code = pytest_in(foreign, *kept, "serial", LOST_FRAMES, python=python)
    assert code == 0, serial
    assert "2 passed" in serial, serial
    assert set(figures(serial)) < set(figures(text))
    one_by_one = logs(foreign / "serial")
    assert len(set(one_by_one.values())) == 2
    assert one_by_one.items() < logs(foreign / "parallel").items()


@pytest.mark.long
def test_the_examples_as_they_stand_serially_and_in_parallel(
    installed: Installed, foreign: Path
) -> None:
    python, kept = str(installed.python), ("--tonus-keep=all", "--tonus-out")
    parallel, code = pytest_in(foreign, "-n2", *kept, "parallel", python=python)
    assert code == 0, parallel
    serial, code = pytest_in(foreign, *kept, "serial", python=python)
    assert code == 0, serial
    assert len(figures(serial)) == 101
    assert figures(serial) == figures(parallel)
    assert len(set(logs(foreign / "serial").values())) > 50
    assert logs(foreign / "serial") == logs(foreign / "parallel")


def test_the_tests_of_a_new_project_pass(installed: Installed, tmp_path: Path) -> None:
    new = tmp_path / "arm"
    told = installed.do(str(installed.python.with_name("tonus")), "new", str(new), folder=tmp_path)
    assert f"next: cd {new} && pytest" in told
    assert (new / "README.md").read_text().startswith("# arm\n")
    assert {".github", ".gitignore"} <= {each.name for each in new.iterdir()}
    text, code = pytest_in(new, "-n2", python=str(installed.python))
    assert code == 0, text
    assert "2 passed" in text, text


@pytest.mark.realtime
def test_the_example_in_real_time(installed: Installed, tmp_path: Path) -> None:
    (tmp_path / REAL_TIME).write_text(files()[REAL_TIME])
    text, code = pytest_in(tmp_path, python=str(installed.python))
    assert code == 0, text
    assert "1 passed" in text or "1 skipped" in text, text
