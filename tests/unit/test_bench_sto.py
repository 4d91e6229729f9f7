"""`make sto` in a short form: torque taken away with brakes and without, and what the page says."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.bench import sto
from tests.torque_off import Case, Fallen, Motion

pytestmark = pytest.mark.wide

WITHOUT = Fallen("centre", "rest", None, False, None, 0.0, 0.1, 0.1, 0.6, 0.05, 50.0, 1.5,
                 "FAULT", "DRIVE_FAULT", at_rest=True)  # fmt: skip


def few(place: str, motion: Motion, *, brakes: bool) -> Iterator[Case]:
    yield Case(place, motion, None, brakes, None)
    if brakes:
        yield Case(place, motion, None, brakes, 0)


def test_it_falls_without_brakes_and_hangs_with_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sto, "cases", few)
    out = tmp_path / "sto.jsonl"
    arguments = ["--places", "1", "--motion", "rest", "--out", str(out)]
    result = CliRunner().invoke(sto.main, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    free, held, failed = (json.loads(line) for line in out.read_text().splitlines())
    assert free["drop"] > 0.09
    assert free["peak_speed"] > 0.3
    assert held["drop"] < 0.005
    assert 0.01 < failed["drop"] < 0.09
    assert "| all, one brake failing | centre | rest | 1 |" in result.output


def test_the_table_has_the_worst_of_each_kind_and_the_page_takes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = [WITHOUT, *(replace(WITHOUT, axis=axis, drop=0.01 * axis) for axis in range(8))]
    source = tmp_path / "sto.jsonl"
    source.write_text("".join(json.dumps(asdict(each)) + "\n" for each in found))
    (tmp_path / "sto.md").write_text("<!-- sto: begin -->\n<!-- sto: end -->\n")
    monkeypatch.setattr(sto, "_DOCS", tmp_path)
    result = CliRunner().invoke(sto.main, ["--from", str(source), "--write"])
    assert result.exit_code == 0, result.output
    page = (tmp_path / "sto.md").read_text()
    assert "9 cases" in page
    assert "| all, no brakes | centre | rest | 1 | 100 | 100 | 0.60 |" in page
    assert "| one, no brakes | centre | rest | 8 | 70 | 100 | 0.60 |" in page
    assert (tmp_path / "sto.png").stat().st_size > 10_000


def test_a_case_that_does_not_end_in_fault_is_a_failure(tmp_path: Path) -> None:
    source = tmp_path / "sto.jsonl"
    source.write_text(json.dumps(asdict(replace(WITHOUT, state="SAFE_STOP"))) + "\n")
    assert CliRunner().invoke(sto.main, ["--from", str(source)]).exit_code == 1
