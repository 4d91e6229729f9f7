"""The wheel, built and installed into an environment of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]


class Installed(NamedTuple):
    wheel: Path
    sdist: Path
    python: Path
    """of an environment with the wheel, which also sees the packages of this one"""

    def do(self, *command: str, folder: Path) -> str:
        """What a command prints; it must end well."""
        return _run(*command, folder=folder)


def build(built: Path, home: Path) -> Installed:
    """Wheel and source distribution in ``built``, the environment in ``home``; both are empty
    folders."""
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
    _warm(packages)
    return Installed(wheel, sdist, python)


def _warm(packages: Path) -> None:
    """Give the environment what has been compiled of this checkout, which takes most of a minute;
    numba knows a source by its time and size."""
    for source in (packages / "tonus").rglob("*.py"):
        ours = (ROOT / "tonus" / source.relative_to(packages / "tonus")).resolve()
        stat = ours.stat()
        os.utime(source, ns=(stat.st_atime_ns, stat.st_mtime_ns))
        for compiled in ours.parent.glob(f"__pycache__/{ours.stem}.*.nb[ic]"):
            place = source.parent / "__pycache__"
            place.mkdir(exist_ok=True)
            shutil.copy2(compiled, place)


def _run(*command: str, folder: Path) -> str:
    """What a command prints; it must end well."""
    bare = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    bare["TONUS_RUNTIME_DIR"] = str(folder / "empty")
    done = subprocess.run(
        command, cwd=folder, env=bare, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
