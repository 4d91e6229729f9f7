"""What a recovery reports as lost was in the file once."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner
from synthetic_run import cycles, record

from tonus.runtime.recording.viewer import Scene
from tonus.tools.cli.log import log as command
from tonus.tools.log.chunks import scan
from tonus.tools.log.recover import Salvage, recover

CORNERS = tuple((float(k), 0.0, 1.0) for k in range(8))
SCENE = Scene(10, CORNERS, CORNERS, (1.0, 2.0, 3.0, 4.0))
TICKS, FIRST_POSE = 600, 203
HEAD = 53
"""bytes of a chunk before its content"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A run whose first pose comes late, as after referencing, and that misses 30 ticks later."""
    rows = cycles(TICKS)
    rows["pose"]["quaternion"][FIRST_POSE:, 0] = 1.0
    rows["timing"]["tick"][400:] += 30
    folder = tmp_path_factory.mktemp("whole")
    return record(folder, TICKS, rows=rows, scene=SCENE, chunk_ms=50).read_bytes()


def recovered(data: bytes, folder: Path) -> Salvage:
    (folder / "run.mcap").write_bytes(data)
    salvage = recover(folder / "run.mcap", folder / "out.mcap")
    assert salvage is not None
    return salvage


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_of_a_sound_log_that_is_cut_nothing_before_the_cut_is_lost(
    whole: bytes, tmp_path: Path, share: float
) -> None:
    salvage = recovered(whole[: int(share * len(whole))], tmp_path)
    assert salvage.kept["/tf"] > 0
    assert salvage.lost == {}
    assert not salvage.beginning_lost
    assert not salvage.complete
    (tmp_path / "out.mcap").unlink()
    told = CliRunner().invoke(command, ["recover", str(tmp_path / "run.mcap")]).output
    assert "lost" not in told
    assert "what was behind the end of the file is not known" in told


def test_a_chunk_that_is_damaged_before_the_cut_is_lost_in_every_topic(
    whole: bytes, tmp_path: Path
) -> None:
    (tmp_path / "run.mcap").write_bytes(whole)
    place = scan(tmp_path / "run.mcap").chunks[6]  # ticks 300 to 349
    data = bytearray(whole[: int(0.9 * len(whole))])
    data[place.offset + place.size // 2] ^= 16
    salvage = recovered(bytes(data), tmp_path)
    assert (salvage.lost["/tonus/timing"], salvage.lost["/tf"]) == (50, 5)
    assert not any(topic.startswith("/can/") for topic in salvage.lost)


@pytest.mark.parametrize("damaged", ["content", "head"])
def test_how_much_a_damaged_beginning_held_is_not_claimed(
    whole: bytes, tmp_path: Path, damaged: str
) -> None:
    (tmp_path / "run.mcap").write_bytes(whole)
    place = scan(tmp_path / "run.mcap").chunks[0]
    data = bytearray(whole[: int(0.9 * len(whole))])
    at = place.offset + (place.size // 2 if damaged == "content" else -HEAD)
    data[at : at + 4] = bytes(255 - byte for byte in data[at : at + 4])
    salvage = recovered(bytes(data), tmp_path)
    assert salvage.ticks is not None
    assert salvage.ticks[0] == 50
    assert salvage.lost == {}
    assert salvage.beginning_lost
