"""The public API: what `tonus.__all__` lists, and docs/api.md describes."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import ValidationError

import tonus
from tonus.config.schema.faults import FAULT, Fault

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "api.md").read_text()
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
ROOMS = ("config", "drivers", "runtime", "sim", "tools")


def python(code: str, folder: Path) -> str:
    """What a program prints that is started in a folder, with nothing but installed packages."""
    bare = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env=bare,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_every_public_name_is_there_and_no_other() -> None:
    for name in tonus.__all__:
        assert getattr(tonus, name) is not None
        assert name in dir(tonus)
    with pytest.raises(AttributeError, match="has no attribute 'lod'"):
        _ = tonus.lod  # type: ignore[attr-defined]


def test_every_kind_of_fault_can_be_made_by_its_class() -> None:
    """Without its kind, which the class has; a fault goes through YAML with it."""
    kinds = get_args(get_args(Fault)[0])
    assert {kind.__name__ for kind in kinds} | {"Fault"} == set(tonus.faults.__all__)
    for kind in kinds:
        assert kind.model_fields["kind"].default in get_args(kind.model_fields["kind"].annotation)
    pulled = tonus.faults.Unplug(channel="can0", node=1)
    assert pulled.model_dump() == {"at": 0.0, "kind": "unplug", "channel": "can0", "node": 1}
    short = pulled.model_dump(exclude_defaults=True)
    assert short == {"kind": "unplug", "channel": "can0", "node": 1}
    assert FAULT.validate_python(short) == pulled
    with pytest.raises(ValidationError, match="kind"):
        FAULT.validate_python({"channel": "can0", "node": 1})


def test_importing_it_loads_nothing_else(tmp_path: Path) -> None:
    heavy = ("click", "numba", "numpy", "pydantic", *(f"tonus.{room}" for room in ROOMS))
    code = f"import sys, tonus; tonus.__all__; print([n for n in {heavy} if n in sys.modules])"
    assert python(code, tmp_path) == "[]"


def test_no_room_can_be_imported_by_its_bare_name(tmp_path: Path) -> None:
    code = (
        "from importlib.util import find_spec\n"
        f"print([find_spec(room) for room in {ROOMS}], find_spec('tonus.tools') is not None)"
    )
    assert python(code, tmp_path) == f"{[None] * len(ROOMS)} True"


def test_the_page_shows_every_name_in_its_table_and_in_an_example() -> None:
    table = "".join(re.findall(r"^\| `.*$", PAGE, re.MULTILINE))
    for name in tonus.__all__:
        assert re.search(rf"`{name}[`(]", table), name
        assert re.search(rf"\btonus\.{name}\b", "".join(EXAMPLES)), name
    shown = set(re.findall(r"\btonus\.([A-Za-z_]+)", "".join(EXAMPLES)))
    assert shown == set(tonus.__all__)


def test_the_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(tmp_path / "runtime"))
    monkeypatch.syspath_prepend(tmp_path)
    for example in EXAMPLES:
        file = re.match(r"# (\w+\.py)\n", example)
        if file:
            Path(file[1]).write_text(example)
            continue
        scope: dict[str, Any] = {"__name__": "example"}
        exec(compile(example, "docs/api.md", "exec"), scope)  # noqa: S102  # our own page
