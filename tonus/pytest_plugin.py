"""The pytest plugin: a lab, whole runs and a daemon as fixtures (docs/testing.md).

pytest loads this module in every project of the environment, so it imports nothing but pytest;
what stands behind a fixture, `tonus.tools.testing`, comes with the fixture's first use.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from tonus.tools.testing.case import Case
    from tonus.tools.testing.daemon import DaemonFactory
    from tonus.tools.testing.held import HeldFactory
    from tonus.tools.testing.lab import VirtualLab
    from tonus.tools.testing.player import LabFactory, Player, Replayer

_OPTIONS = {
    "config": ("PATH", "configuration of runs and labs (default: config/can.yaml)"),
    "seed": ("N", "seed of runs and labs, and the first of tonus_seeds (default: 1)"),
    "out": ("DIR", "folder for what is kept of a run (default: tonus-out)"),
    "keep": ("WHICH", "runs to keep: failed, all or none (default: failed)"),
}
DEFAULTS = {"config": "config/can.yaml", "seed": "1", "out": "tonus-out", "keep": "failed"}
_MARKS = (
    "tonus(config=, overrides=): configuration of the test's runs and labs",
    "tonus_seeds(n): the test with n seeds, each by its own id",
    "tonus_needs(*what): skip without ethercat, realtime, root or kernel-can",
    "tonus_expect(*events): warnings and errors that a run of the test may report",
)
_CASE = pytest.StashKey["Case"]()
_OF_ITS_RUNS, _OF_SHARED_RUNS = "Tonus", "Tonus: shared runs"
"""titles of what is told of a failed test"""
_REAL_TIME = "tonus-real-time"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options, and ini keys of the same names."""
    group = parser.getgroup("tonus", "Tonus: cable robots and their lab")
    for name, (metavar, text) in _OPTIONS.items():
        group.addoption(f"--tonus-{name}", metavar=metavar, default=None, help=text)
        parser.addini(f"tonus_{name}", text, default=DEFAULTS[name])
    group.addoption(
        "--tonus-durations", action="store_true", help="list what each test's runs cost"
    )


def pytest_configure(config: pytest.Config) -> None:
    """Register the marks; refuse settings that mean nothing."""
    for mark in _MARKS:
        config.addinivalue_line("markers", mark)
    keep, seed, out = (setting(config, name) for name in ("keep", "seed", "out"))
    wrong = "tonus_{}: {!r} is not possible; choose {}"
    if keep not in ("failed", "all", "none"):
        raise pytest.UsageError(wrong.format("keep", keep, "failed, all or none"))
    if not (seed.isascii() and seed.isdecimal()):
        raise pytest.UsageError(wrong.format("seed", seed, "a whole number from 0 on"))
    folder = config.rootpath / out
    for place in (folder, *folder.parents):
        if place.exists() and not place.is_dir():
            raise pytest.UsageError(f"tonus_out: {place} is no folder; choose another")


def setting(config: pytest.Config, name: str) -> str:
    """An option, or the ini key of the same name."""
    chosen = config.getoption(f"tonus_{name}")
    return str(config.getini(f"tonus_{name}") if chosen is None else chosen)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A test with ``tonus_seeds(n)`` becomes n tests."""
    mark = metafunc.definition.get_closest_marker("tonus_seeds")
    if mark is None:
        return
    if [type(each) for each in mark.args] != [int] or mark.args[0] < 1 or mark.kwargs:
        text = "tonus_seeds takes one whole number, from 1 on"
        raise pytest.Collector.CollectError(f"{metafunc.definition.nodeid}: {text}")
    first = int(setting(metafunc.config, "seed"))
    seeds = range(first, first + mark.args[0])
    if "tonus_seed" not in metafunc.fixturenames:
        metafunc.fixturenames.append("tonus_seed")
    metafunc.parametrize("tonus_seed", seeds, indirect=True, ids=[f"seed{n}" for n in seeds])


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Tests in real time form one group, for ``pytest -n N --dist loadgroup``."""
    if not config.pluginmanager.hasplugin("xdist"):
        return
    for item in items:
        if "tonus_daemon" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.xdist_group(_REAL_TIME))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a test whose needs the host does not meet."""
    marks = list(item.iter_markers("tonus_needs"))
    if marks:
        from tonus.tools.testing.needs import NEEDS, missing

        known = f"{item.nodeid}: tonus_needs knows {', '.join(NEEDS)}"
        for mark in marks:
            if not mark.args or mark.kwargs:
                pytest.fail(f"{known}; name one", pytrace=False)
            for what in mark.args:
                if what not in NEEDS:
                    pytest.fail(f"{known}, not {what!r}", pytrace=False)
                reason = missing(what)
                if reason:
                    pytest.skip(f"needs {what}: {reason}")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """A warning or an error that nobody expected fails the test that passed until now."""
    __tracebackhide__ = True
    try:
        result = yield
    except BaseException:
        with suppress(Exception):  # the test's own error is the one to be told
            if _CASE in item.stash:
                item.stash[_CASE].end_runs()
        raise
    case = item.stash.get(_CASE, None)
    if case is not None:
        case.end_runs()
        case.undisturbed([n for mark in item.iter_markers("tonus_expect") for n in mark.args])
    return result


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Keep what a failed test's runs left, and say where; with how to run the test again. A mistake
    in the use of a fixture is told without the code of Tonus."""
    mistake = _mistake(call)
    report = yield
    if mistake:
        report.longrepr = f"{item.nodeid}: {mistake}"
    own = item.stash.get(_CASE, None) if call.when == "call" else None
    shared = _shared_case(item) if call.when != "teardown" else None
    for title, case in ((_OF_ITS_RUNS, own), (_OF_SHARED_RUNS, shared)):
        if case is not None:
            _keep(item, case, title, report, call)
    if call.when == "call" and (own is not None or shared is not None):
        _add_figures(report, own, shared, call.duration)
    return report


def _shared_case(item: pytest.Item) -> Case | None:
    """Of the runs that a test shares with others of its file."""
    module = item.getparent(pytest.Module)
    if module is None or "tonus_shared_run" not in getattr(item, "fixturenames", ()):
        return None
    return module.stash.get(_CASE, None)


def _keep(
    item: pytest.Item,
    case: Case,
    title: str,
    report: pytest.TestReport,
    call: pytest.CallInfo[None],
) -> None:
    """Keep the runs as the option says, and tell of them below a failure."""
    keep = setting(item.config, "keep")
    if keep == "all" or (keep == "failed" and report.failed):
        kept = case.keep(failed=report.failed)
        paths = [(f"tonus_{name}", str(path)) for name, path in kept]
        report.user_properties += paths
        item.user_properties += paths  # of which the JUnit file is made, at the teardown
    if report.failed:
        error = call.excinfo.value if call.excinfo is not None else None
        text = case.account(error, kept=keep != "none", nodeid=item.nodeid)
        add = getattr(report.longrepr, "addsection", None)
        if add is not None:
            add(title, text)
        else:
            report.sections.append((title, text))


def _add_figures(
    report: pytest.TestReport, own: Case | None, shared: Case | None, duration: float
) -> None:
    """For the tables at the end. A shared run's cost is that of the first test that uses it."""
    bring_up, run = (0.0, 0.0) if own is None else own.spent()
    before, shared_run = (0.0, 0.0) if shared is None else shared.spent()
    spent = {
        "bring_up": bring_up + before,
        "run": run + shared_run,
        "analysis": max(duration - bring_up - run, 0.0),
    }
    measures = [] if own is None else own.measures
    # In the report's dictionary, so that pytest-xdist brings it from its workers.
    report.__dict__["tonus"] = {"measures": measures, "durations": spent}


def _mistake(call: pytest.CallInfo[None]) -> str:
    """The text of an error that has to be told by itself, for no line of the test is involved."""
    if call.excinfo is None or not type(call.excinfo.value).__module__.startswith(
        ("tonus.", "can.")
    ):
        return ""
    from tonus.tools.testing.mistakes import MISTAKES, shorten

    if not isinstance(call.excinfo.value, MISTAKES) or shorten(call.excinfo):
        return ""
    return str(call.excinfo.value)


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Tables of the figures that tests recorded, and of what their runs cost."""
    config = terminalreporter.config
    reports = [
        report
        for group in terminalreporter.stats.values()
        for report in group
        if getattr(report, "tonus", None)
    ]
    measured = [(each, report.nodeid) for report in reports for each in report.tonus["measures"]]
    if measured:
        terminalreporter.section("Tonus: measured")
        for each, nodeid in measured:
            bound = "" if each["at_most"] is None else f"  at most {each['at_most']:g}"
            figure = f"{each['value']:.6g} {each['unit']}"
            terminalreporter.line(f"{each['name']:<28} {figure:>18}{bound}  {nodeid}")
    if config.getoption("tonus_durations") and reports:
        terminalreporter.section("Tonus: wall time in s")
        terminalreporter.line(f"{'bring-up':>9} {'run':>9} {'analysis':>9}")
        for report in reports:
            spent = report.tonus["durations"]
            if not spent["run"]:
                continue
            figures = " ".join(f"{spent[key]:9.2f}" for key in ("bring_up", "run", "analysis"))
            terminalreporter.line(f"{figures}  {report.nodeid}")


@pytest.fixture
def tonus_seed(request: pytest.FixtureRequest) -> int:
    """The seed of this test's runs and labs."""
    return int(getattr(request, "param", setting(request.config, "seed")))


@contextmanager
def _made(request: pytest.FixtureRequest, seed: int) -> Iterator[Case]:
    """A case for the runs and labs of a test, or for the runs that the tests of a file share."""
    from tonus.tools.testing.arguments import mapping
    from tonus.tools.testing.case import Case

    node, config = request.node, request.config
    chosen: dict[str, Any] = {}
    overrides: dict[str, Any] = {}
    for mark in reversed(list(node.iter_markers("tonus"))):  # the module's first, the test's last
        if mark.args or mark.kwargs.keys() - {"config", "overrides"}:
            pytest.fail(f"{node.nodeid}: tonus takes config= and overrides=", pytrace=False)
        chosen |= mark.kwargs
        overrides |= mapping("overrides", mark.kwargs.get("overrides"))
    case = Case(
        node.nodeid,
        file=node.path,
        root=config.rootpath,
        invoked=config.invocation_params.dir,
        out=config.rootpath / setting(config, "out"),
        config=chosen.get("config", setting(config, "config")),
        overrides=overrides,
        seed=seed,
        options=[
            f"--tonus-{name}={config.getoption(f'tonus_{name}')}"
            for name in ("config", "seed", "out")
            if config.getoption(f"tonus_{name}") is not None
        ],
    )
    node.stash[_CASE] = case
    try:
        yield case
    finally:
        del node.stash[_CASE]
        case.close()


@pytest.fixture
def _tonus_case(request: pytest.FixtureRequest, tonus_seed: int) -> Iterator[Case]:
    with _made(request, tonus_seed) as case, case.active():
        yield case


@pytest.fixture(scope="module")
def tonus_shared_run(request: pytest.FixtureRequest) -> Iterator[Player]:
    """As ``tonus_run``, for a fixture of the file: several tests look at one `Run`."""
    from tonus.tools.testing.player import Player

    expected = [name for mark in request.node.iter_markers("tonus_expect") for name in mark.args]
    with _made(request, int(setting(request.config, "seed"))) as case:
        yield Player(case, expected)


@pytest.fixture
def tonus_lab_factory(_tonus_case: Case) -> LabFactory:
    """Makes labs: ``tonus_lab_factory(config=, overrides=, seed=, script=)``."""
    from tonus.tools.testing.player import LabFactory

    return LabFactory(_tonus_case)


@pytest.fixture
def tonus_lab(tonus_lab_factory: LabFactory) -> VirtualLab:
    """A lab in this process, in virtual time."""
    return tonus_lab_factory()


@pytest.fixture
def tonus_run(_tonus_case: Case) -> Player:
    """Plays a scenario in virtual time and gives the `Run`."""
    from tonus.tools.testing.player import Player

    return Player(_tonus_case)


@pytest.fixture
def tonus_held(_tonus_case: Case) -> HeldFactory:
    """A run that begins with the robot in HOLD or ACTIVE, and goes on as the test says."""
    from tonus.tools.testing.held import HeldFactory

    return HeldFactory(_tonus_case)


@pytest.fixture
def tonus_replay(_tonus_case: Case) -> Replayer:
    """Opens a log, replays it bit for bit and gives the `Run`."""
    from tonus.tools.testing.player import Replayer

    return Replayer(_tonus_case)


@pytest.fixture
def tonus_daemon(_tonus_case: Case) -> DaemonFactory:
    """Starts a daemon and its lab as processes, in real time."""
    from tonus.tools.testing.daemon import DaemonFactory

    return DaemonFactory(_tonus_case)


@pytest.fixture
def tonus_measure(_tonus_case: Case, record_property: Any) -> Any:
    """Records a figure: ``tonus_measure(name, value, unit, at_most=)``."""

    from tonus.tools.testing.arguments import real

    def measure(name: str, value: float, unit: str, at_most: float | None = None) -> float:
        __tracebackhide__ = True
        figure = real(name, value)
        record_property(f"{name} [{unit}]", value)
        _tonus_case.measure(name, figure, unit, at_most)
        return figure

    return measure
