"""Its place puts this folder on the import path: `loop` and `statue` serve tests of every kind.

A test in real time that failed is tried again, twice at most, if the host disturbed it: if it
stalled meanwhile, as measured beside it (`tests.stalls`), or computes unevenly, as measured at once
afterwards (`tests.pace`). What fails without that has failed, and so has a test in real time that
skips itself once it runs; what passed at a later try is listed with the traceback and the
disturbance of the earlier one. A test that failed each time on a host that disturbed it each time,
at last unevenly or by stalls longer than any deadline of the daemon, at once or in pieces, is
skipped with what was measured: such a host has no real time to test. The same runs are tested in
virtual time, on every host. A refused configuration is refused on every host: nothing excuses it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Generator
from functools import partial

# Before numpy is imported, as in tonus.tools: a second thread for matrices of 6 x 8 only takes the
# other worker's processor.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from _pytest._code.code import ExceptionRepr

from tests import pace, stalls
from tonus.config.loader import HERE

TRIES = 3
HOPELESS_NS, WITHIN_NS = 10_000_000, 25_000_000
"""A stall after which drives stop by themselves or measurements are stale, whatever we do; or
stalls that take as long of the time after which a drive counts as lost (`stale_stop_ticks` of a
lab)."""
UNEVEN = 1.25
"""times as long for the same computation: a tick has no such reserve on the slowest host on which
the tests pass"""
SHOWN = 5
"""stalls, the longest"""
LONG = {"test_short_forms.py", "test_tune.py", "test_tutorials.py", "test_wheel.py"}
"""files at the end of the alphabet that take long: first, so that no worker has to wait for them"""
OUT = HERE.parent / "out"
BEGIN_NS = pytest.StashKey[int]()
TIMES_AS_LONG = pytest.StashKey[float]()
REFUSED = pytest.StashKey[bool]()
REFUSAL = re.compile(r"\S\.ya?ml:\d+: ")
"""as `tonus` names the place of a refused value"""
MEANWHILE = "disturbances by the host"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.path.name not in LONG)
    for item in items:
        if item.get_closest_marker("realtime"):
            excuse = partial(host_disturbed, item)
            item.add_marker(pytest.mark.flaky(reruns=TRIES - 1, condition=excuse))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("realtime"):
        stalls.watching()
        item.stash[BEGIN_NS] = stalls.now_ns()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if BEGIN_NS not in item.stash:
        return report
    if report.skipped and call.when == "call":
        report.outcome = "failed"
        report.longrepr = (
            f"{item.nodeid} skipped itself once it ran: let it fail, and be tried again"
        )
    if report.failed and isinstance(report.longrepr, ExceptionRepr):
        if call.excinfo is not None:
            # The fixture of a module fails once, and its error is each of its tests': the first
            # of them says when.
            began = call.excinfo.value.__dict__.setdefault("began_ns", item.stash[BEGIN_NS])
            item.stash[BEGIN_NS] = began
        crash = report.longrepr.reprcrash
        item.stash[REFUSED] = crash is not None and REFUSAL.search(crash.message) is not None
        found = stalls.watching().since(item.stash[BEGIN_NS])
        longest = sorted(found, key=lambda stall: stall.begin_ns - stall.end_ns)[:SHOWN]
        uneven = item.stash[TIMES_AS_LONG] = pace.unevenness()
        lines = [*map(str, longest), f"{len(found)} stalls in all"]
        lines.append(f"up to {uneven:.2f} times as long for the same computation")
        report.longrepr.addsection(MEANWHILE, "\n".join(lines))
        last = getattr(item, "execution_count", 1) >= TRIES
        hopeless = stalls.most_within(found, WITHIN_NS) >= HOPELESS_NS
        if last and not item.stash[REFUSED] and (hopeless or uneven >= UNEVEN):
            report.outcome = "skipped"
            reason = f"the host disturbed each of {TRIES} tries: {', '.join(lines)}"
            report.longrepr = (str(item.path), item.location[1] or 0, reason)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """What somebody ran in this checkout stays as it is: a test writes to its own folder."""
    before = _written()
    result = yield
    if _written() != before:
        raise pytest.UsageError(f"{item.nodeid} wrote to {OUT}; give it --out or another folder")
    return result


def _written() -> set[str]:
    return {each.name for each in OUT.iterdir()} if OUT.is_dir() else set()


def host_disturbed(item: pytest.Item) -> bool:
    if item.stash.get(REFUSED, False):
        return False
    stalled = bool(stalls.watching().since(item.stash[BEGIN_NS]))
    return stalled or item.stash.get(TIMES_AS_LONG, 1.0) >= UNEVEN
