"""A test that writes to the checkout's folder of runs is named: as tests/conftest.py says."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest_plugins = ["pytester"]

MODULE = """
from pathlib import Path

def test_it(): Path({where!r}).mkdir(parents=True)
"""
INI = """
[pytest]
markers =
    realtime:
"""


@pytest.mark.parametrize(("where", "named"), [("out/20261122-120000-can-hold", True), ("a", False)])
def test_a_test_that_writes_to_the_users_folder_is_named(
    pytester: pytest.Pytester, where: str, named: bool
) -> None:
    conftest = (Path(__file__).parents[1] / "conftest.py").read_text()
    ours = conftest.replace("OUT = HERE.parent", f"OUT = Path({str(pytester.path)!r})")
    assert ours != conftest
    pytester.makeini(INI)
    pytester.makeconftest(
        ours.replace("import pytest\n", "import pytest\nfrom pathlib import Path\n")
    )
    pytester.makepyfile(MODULE.format(where=str(pytester.path / where)))
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider")
    told = result.stderr.str() + result.stdout.str()
    assert ("test_it wrote to" in told) is named
    assert (result.ret != 0) is named
