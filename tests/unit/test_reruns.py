"""When a test in real time is tried again: as tests/conftest.py says."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from tests import pace, stalls
from tests.foreign import EDITABLE
from tests.stalls import Stall, Watch
from tonus.runtime.timing import clock

pytest_plugins = ["pytester"]

STALL_NS, LONG_NS = 5_000_000, 20_000_000
MS = 1_000_000
EVEN, UNEVEN = 1.2, 1.3
"""times as long as at best"""
MODULE = """
from itertools import count
from pathlib import Path
import pytest
from tests.stalls import now_ns

numbers = count()

@pytest.mark.{mark}
def test_it():
    if {during}:
        now = now_ns()
        with Path({path!r}).open("a") as file:
            file.write(f"{{now}} {{now + {during}}} 0\\n")
    assert next(numbers) in {good}
"""
REFUSES = """
from pathlib import Path
import pytest
from tests.stalls import now_ns

@pytest.mark.realtime
def test_it():
    now = now_ns()
    with Path({path!r}).open("a") as file:
        file.write(f"{{now}} {{now + {during}}} 0\\n")
    text = "compiling ...\\ntonus: config/control.yaml:114: control.bogus: is not a key"
    assert not text, text
"""
SHARES = """
from itertools import count
from pathlib import Path
import pytest
from tests.stalls import now_ns

numbers = count()

@pytest.fixture(scope="module")
def shared():
    if {during}:
        now = now_ns()
        with Path({path!r}).open("a") as file:
            file.write(f"{{now - {during}}} {{now}} 0\\n")
    assert next(numbers) in {good}

@pytest.mark.realtime
def test_it(shared): pass

@pytest.mark.realtime
def test_other(shared): pass
"""
SKIPS = """
import pytest

@pytest.mark.realtime
def test_it(): pytest.skip("the host is busy")

@pytest.mark.realtime
@pytest.mark.skipif(True, reason="not root")
def test_other(): assert False
"""
INI = """
[pytest]
markers =
    realtime:
    long:
"""


@pytest.fixture
def watch(monkeypatch: pytest.MonkeyPatch) -> Iterator[Watch]:
    """Without watchers: a test writes the stalls."""
    with closing(Watch(())) as made:
        monkeypatch.setattr(stalls, "watching", lambda: made)
        monkeypatch.setattr(pace, "unevenness", lambda: EVEN)
        yield made


def stalled(watch: Watch, begin_ns: int) -> None:
    with watch.path.open("a") as file:
        file.write(f"{begin_ns} {begin_ns + STALL_NS} 0\n")


def played(pytester: pytest.Pytester, module: str) -> pytest.RunResult:
    pytester.makeini(INI)
    pytester.makeconftest((Path(__file__).parents[1] / "conftest.py").read_text())
    pytester.makepyfile(module)
    options = ["-p", "no:cacheprovider", "--rerun-show-tracebacks", *EDITABLE]
    return pytester.runpytest_inprocess(*options)


@pytest.mark.parametrize(
    ("mark", "good", "during", "outcome"),
    [
        ("realtime", {0}, STALL_NS, {"passed": 1}),
        ("realtime", {1}, STALL_NS, {"passed": 1, "rerun": 1}),
        ("realtime", {2}, STALL_NS, {"passed": 1, "rerun": 2}),
        ("realtime", {3}, STALL_NS, {"failed": 1, "rerun": 2}),
        ("realtime", {3}, LONG_NS, {"skipped": 1, "rerun": 2}),
        ("realtime", {1}, 0, {"failed": 1}),
        ("long", {1}, STALL_NS, {"failed": 1}),
    ],
)
def test_only_what_fails_while_the_host_stalls_is_tried_again(
    pytester: pytest.Pytester,
    watch: Watch,
    mark: str,
    good: set[int],
    during: int,
    outcome: dict[str, int],
) -> None:
    stalled(watch, stalls.now_ns() - 2 * STALL_NS)  # before the test, which it cannot explain
    module = MODULE.format(mark=mark, good=good, during=during, path=str(watch.path))
    result = played(pytester, module)
    assert result.parseoutcomes() == outcome
    if mark == "realtime" and good != {0}:
        measured = f"{during / 1e6:.1f} ms on processor 0" if during else "0 stalls in all"
        result.stdout.fnmatch_lines(["*disturbances by the host*", measured])


@pytest.mark.parametrize(
    ("mark", "good", "outcome"),
    [
        ("realtime", {0}, {"passed": 1}),
        ("realtime", {1}, {"passed": 1, "rerun": 1}),
        ("realtime", {3}, {"skipped": 1, "rerun": 2}),
        ("long", {1}, {"failed": 1}),
    ],
)
def test_an_uneven_host_disturbs_as_one_that_stalls(
    pytester: pytest.Pytester,
    watch: Watch,
    monkeypatch: pytest.MonkeyPatch,
    mark: str,
    good: set[int],
    outcome: dict[str, int],
) -> None:
    monkeypatch.setattr(pace, "unevenness", lambda: UNEVEN)
    module = MODULE.format(mark=mark, good=good, during=0, path=str(watch.path))
    result = played(pytester, module)
    assert result.parseoutcomes() == outcome
    if "rerun" in outcome:
        result.stdout.fnmatch_lines(["up to 1.30 times as long for the same computation"])


def test_nothing_excuses_a_refused_configuration(
    pytester: pytest.Pytester, watch: Watch, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pace, "unevenness", lambda: UNEVEN)
    module = REFUSES.format(path=str(watch.path), during=LONG_NS)
    assert played(pytester, module).parseoutcomes() == {"failed": 1}


def test_times_are_compared_with_the_least_there_has_been() -> None:
    """Nine of ten count, of the slowest processor."""
    least: list[int] = []
    assert pace.compared([[10] * 18 + [90] * 2, [11] * 20], least) == 1.1
    assert pace.compared([[20] * 17 + [30] * 3], least) == 3.0
    assert pace.compared([[8] * 20], least) == 1.0
    assert pace.compared([[10] * 20], least) == 1.25
    assert pace.compared([[10] * 20, []], least) == 1.0, "refused"


def test_the_host_is_as_quick_as_itself_at_best() -> None:
    assert pace.unevenness() >= 1.0


@pytest.mark.parametrize(
    ("good", "during", "outcome"),
    [
        ({3}, LONG_NS, {"passed": 1, "skipped": 1, "rerun": 3}),
        ({9}, LONG_NS, {"skipped": 2, "rerun": 4}),
        ({3}, 0, {"errors": 2}),
    ],
)
def test_what_stalled_a_fixture_excuses_each_test_of_it(
    pytester: pytest.Pytester, watch: Watch, good: set[int], during: int, outcome: dict[str, int]
) -> None:
    module = SHARES.format(path=str(watch.path), good=good, during=during)
    assert played(pytester, module).parseoutcomes() == outcome


@pytest.mark.parametrize(
    ("found", "most_ms"),
    [
        ([], 0),
        ([(0, 9)], 9),
        ([(0, 40)], 25),
        ([(0, 9), (12, 14), (24, 26), (40, 41)], 12),
        ([(0, 2), (20, 26), (27, 31), (40, 45)], 15),
        ([(0, 9), (3, 5), (4, 12)], 12),
    ],
)
def test_stalls_in_pieces_count_together(found: list[tuple[int, int]], most_ms: int) -> None:
    """Of 25 ms; on two processors at once they count once."""
    seen = [Stall(begin * MS, end * MS, 0) for begin, end in reversed(found)]
    assert stalls.most_within(seen, 25 * MS) == most_ms * MS


@pytest.mark.usefixtures("watch")
def test_a_test_in_real_time_that_skips_itself_has_failed(pytester: pytest.Pytester) -> None:
    assert played(pytester, SKIPS).parseoutcomes() == {"failed": 1, "skipped": 1}


def test_a_stall_is_measured() -> None:
    """Of a watcher that stands still for a while; more the host may add."""
    with closing(Watch(sorted(os.sched_getaffinity(0))[:1])) as watch:
        if watch.refused:
            pytest.skip("the host refuses SCHED_FIFO, without which no stall is measured")
        (watcher,) = watch.processes
        begin_ns = stalls.now_ns()
        watcher.send_signal(signal.SIGSTOP)
        clock.pause(0.2)
        end_ns = stalls.now_ns()
        watcher.send_signal(signal.SIGCONT)
        longest = max(watch.since(begin_ns), key=lambda stall: stall.end_ns - stall.begin_ns)
        assert longest.begin_ns <= begin_ns + 2_000_000
        assert longest.end_ns >= end_ns
        assert not watch.since(stalls.now_ns() + STALL_NS)


def test_what_the_kernel_withholds_from_real_time_excuses_nothing() -> None:
    """50 ms of a second, as `man 7 sched` has it, from processes that would use all of it."""
    assert stalls.throttled(Stall(0, 51_700_000, 0))
    assert not stalls.throttled(Stall(0, 5_000_000, 0))
    assert not stalls.throttled(Stall(0, 120_000_000, 0))
