"""Its place puts this folder on the import path: `loop` and `statue` serve tests of every kind.

A test in real time that failed is tried again if the host took processor time from it meanwhile,
by the count of its hypervisor. What fails each time, or without such an excuse, has failed; what
passed at a later try is listed with the traceback of the earlier one.
"""

from __future__ import annotations

from collections.abc import Generator
from functools import partial

import pytest

from tonus.config.loader import HERE
from tonus.runtime.timing.realtime import stolen_jiffies

TRIES = 3
OUT = HERE.parent / "out"
STOLEN = pytest.StashKey[int]()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.get_closest_marker("realtime"):
            excuse = partial(host_took_time, item)
            item.add_marker(pytest.mark.flaky(reruns=TRIES - 1, condition=excuse))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    item.stash[STOLEN] = stolen_jiffies()[0]


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


def host_took_time(item: pytest.Item) -> bool:
    return stolen_jiffies()[0] > item.stash[STOLEN]
