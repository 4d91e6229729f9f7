"""A run that ends before it began leaves nothing behind: no lab, no traceback."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.composed import configured, virtual
from tonus.config.loader import HERE
from tonus.sim.can import registry
from tonus.tools.errors import ToolError
from tonus.tools.run import fieldbuses


def test_a_run_that_cannot_be_composed_takes_its_lab_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every later run of the process found the channels taken."""
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(tmp_path / "runtime"))
    config, scenario = configured(duration=0.1)

    def refuse(*_: object, **__: object) -> None:
        assert registry.find("can0") is not None, "the lab is there by now"
        raise ToolError("no such fieldbus")

    with monkeypatch.context() as patched:
        patched.setattr(fieldbuses, "build", refuse)
        with pytest.raises(ToolError, match="no such fieldbus"):
            virtual(config, scenario, tmp_path / "out")
    assert all(registry.find(f"can{number}") is None for number in range(4))


def test_an_interrupt_while_the_program_itself_is_loaded_ends_it_without_a_traceback() -> None:
    """By the console script's entry point, at the first import that takes a while."""
    project = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))
    module, _, function = project["project"]["scripts"]["tonus"].partition(":")
    code = (
        "import os, signal, sys\n"
        "class Interrupting:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'click':\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Interrupting())\n"
        "sys.argv = ['tonus', '--version']\n"
        f"from {module} import {function}\n"
        f"{function}()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=HERE.parent, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (1, "", "")


def test_an_interrupt_while_a_command_is_loaded_ends_it_without_a_traceback() -> None:
    code = (
        "import os, signal\n"
        "from tonus.tools.cli import main\n"
        "with main._loading():\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    for _ in range(10**9): pass\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=HERE.parent, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (1, "")


def test_a_command_that_is_interrupted_ends_without_a_traceback() -> None:
    code = (
        "import sys\n"
        "from unittest.mock import patch\n"
        "from tonus.tools.cli import check, main\n"
        "sys.argv = ['tonus', 'check', 'config/direct.yaml']\n"
        "with patch.object(check, 'load', side_effect=KeyboardInterrupt):\n"
        "    main.main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=HERE.parent, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
