"""pytest in a project of somebody else, in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

from tonus.config.loader import HERE

EDITABLE = ["-W", "ignore:Module already imported so cannot be rewritten"]
"""for pytest where Tonus is installed as editable: of the hook that such an installation imports"""


def pytest_in(folder: Path, *words: str, python: str | None = None) -> tuple[str, int]:
    """What pytest prints in a folder, and its exit code; ``python`` of another environment, where
    Tonus is installed."""
    bare = {name: value for name, value in os.environ.items() if not name.startswith("PY")}
    command = [python or sys.executable, "-m", "pytest", "-p", "no:cacheprovider"]
    if python is None:
        command += EDITABLE
        bare["PYTHONPATH"] = str(HERE.parent)
        # An environment made before the plugin was there does not know of it.
        if not any(each.name == "tonus" for each in entry_points(group="pytest11")):
            command += ["-p", "tonus.pytest_plugin"]
    done = subprocess.run(
        [*command, *words], cwd=folder, env=bare, capture_output=True, text=True, check=False
    )
    return done.stdout + done.stderr, done.returncode
