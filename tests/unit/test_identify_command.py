"""`tonus log identify` with logs that say nothing: one line, exit code 2."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from synthetic_run import MS, recording

from tonus.config import load
from tonus.runtime.recording.recorder import Recorder
from tonus.runtime.recording.ring import RingWriter
from tonus.runtime.signals import cycle_dtype, topics
from tonus.runtime.states import State
from tonus.runtime.topics import to_json
from tonus.tools.cli.main import main
from tonus.tools.identify.record import read

CYCLE, TOPICS = cycle_dtype(8), topics(8)

TICKS = 3000
CONFIG, _ = load("config/direct.yaml")


def standing(poses: int = 360) -> NDArray[np.void]:
    """Cycles of a robot that stands in ACTIVE, with this many tracker poses."""
    rows = np.zeros(TICKS, CYCLE)
    rows["timing"]["tick"] = np.arange(TICKS)
    rows["state"]["state"] = State.ACTIVE
    rows["tension"]["measured"] = 45.0
    rows["tracker"]["quaternion"][:, 0] = 1.0
    rows["tracker"]["fresh"][:: TICKS // poses] = 1
    return rows


def recorded(folder: Path, rows: NDArray[np.void], config: str | None = None) -> Path:
    """The rows as a log, with the shipped configuration or another text attached."""
    folder.mkdir(parents=True)
    meta = {"kind": "record", "topics": to_json(TOPICS)}
    ring = RingWriter.create(folder / "cycle.ring", CYCLE.itemsize, 2 * TICKS, meta)
    text = yaml.safe_dump(CONFIG.model_dump(mode="json")) if config is None else config
    attached = {"config.yaml": text.encode()} if text else {}
    path = folder / "run.mcap"
    recorder = Recorder(folder, path, recording(), {"seed": "1"}, attached, 0)
    for k in range(len(rows)):
        ring.publish(rows[k : k + 1], k * MS)
    recorder.finish()
    return path


def refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: str
) -> str:
    """The one line that the command leaves on standard error."""
    monkeypatch.setattr(sys, "argv", ["tonus", "log", "identify", *arguments])
    with pytest.raises(SystemExit) as ending:
        main()
    assert ending.value.code == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    return lines[0]


def test_a_log_without_motion_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = recorded(tmp_path / "a", standing())
    line = refused(monkeypatch, capsys, str(path), "--out", str(tmp_path / "out"))
    assert str(path) in line
    assert "does not move" in line
    assert "identify_motion" in line
    assert not (tmp_path / "out").exists()


def test_a_log_without_tracker_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = recorded(tmp_path / "a", standing(poses=5))
    assert "5 tracker poses, 100 are needed" in refused(monkeypatch, capsys, str(path))


def test_a_damaged_log_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = recorded(tmp_path / "a", standing())
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert "damaged" in refused(monkeypatch, capsys, str(path))


def test_a_log_that_never_became_active_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    rows = standing()
    rows["state"]["state"] = State.STANDBY
    path = recorded(tmp_path / "a", rows)
    assert "in ACTIVE no tick has fresh samples" in refused(monkeypatch, capsys, str(path))


@pytest.mark.parametrize(
    ("config", "words"), [("", "carries no configuration"), ("name: other\n", "not this version's")]
)
def test_a_log_without_its_robot_is_refused(
    config: str,
    words: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    path = recorded(tmp_path / "a", standing(), config)
    assert words in refused(monkeypatch, capsys, str(path))


def test_logs_of_two_robots_are_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    data = CONFIG.model_dump(mode="json")
    data["robot"]["drum"]["radius"] = 0.03
    one = recorded(tmp_path / "a", standing())
    other = recorded(tmp_path / "b", standing(), yaml.safe_dump(data))
    line = refused(monkeypatch, capsys, str(one), str(other))
    assert str(other) in line
    assert "another robot" in line


def test_missed_ticks_are_bridged_and_not_believed(tmp_path: Path) -> None:
    rows = standing()
    rows["drives"]["angle"][:, 0] = 0.01 * np.arange(TICKS)
    rows["force_cells"]["age"][2000, 3] = 1
    whole = np.delete(rows, slice(1000, 1010))
    record = read(recorded(tmp_path / "a", whole))
    assert len(record.time) == TICKS
    np.testing.assert_allclose(record.angle[:, 0], 0.01 * np.arange(TICKS), atol=1e-12)
    np.testing.assert_array_equal(np.flatnonzero(~record.good), [*range(1000, 1010), 2000])
    np.testing.assert_allclose(np.diff(record.time), 1e-3)
