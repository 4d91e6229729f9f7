"""Every statement and every branch of the supervisor is reached by its own unit tests."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.wide

ROOT = Path(__file__).parents[2]
OTHERS = {*Path(__file__).parent.glob("test_supervisor_*.py")} - {Path(__file__)}
TESTS = sorted(map(str, OTHERS))


def test_every_branch_of_the_supervisor_is_tried(tmp_path: Path) -> None:
    data = f"--data-file={tmp_path / 'coverage'}"
    coverage = [sys.executable, "-m", "coverage"]
    measured = [*coverage, "run", "--branch", data, "--include=*/runtime/supervisor/*"]
    tests = ["-m", "pytest", "-q", "-p", "no:cacheprovider", *TESTS]
    ran = subprocess.run([*measured, *tests], cwd=ROOT, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout
    page = tmp_path / "coverage.json"
    report = [*coverage, "json", data, "-o", str(page)]
    subprocess.run(report, cwd=ROOT, check=True, capture_output=True)
    found = json.loads(page.read_text(encoding="utf-8"))
    reached = {Path(name).name for name in found["files"]}
    written = {path.name for path in (ROOT / "runtime/supervisor").glob("*.py")}
    assert reached == written
    missing = {
        name: (each["missing_lines"], each["missing_branches"])
        for name, each in found["files"].items()
        if each["missing_lines"] or each["missing_branches"]
    }
    assert not missing
