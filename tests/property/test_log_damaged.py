"""Whatever happens to a file, its reader ends with data or with one line, and never touches it."""

from __future__ import annotations

import json
import shutil
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import zstandard
from click.testing import CliRunner
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from synthetic_run import record

from tonus.runtime.recording.mcap_file import McapFile
from tonus.tools.cli.log import log as command
from tonus.tools.cli.log.info import describe
from tonus.tools.errors import ToolError
from tonus.tools.log import open as open_log
from tonus.tools.log.chunks import scan
from tonus.tools.log.export import export
from tonus.tools.log.recover import recover
from tonus.tools.log.replay import replay

pytestmark = pytest.mark.wide

QUIET = settings(
    max_examples=25,
    derandomize=True,
    deadline=None,
    phases=[Phase.generate],
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
TICKS = 300


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return record(tmp_path_factory.mktemp("whole"), TICKS, chunk_ms=50).read_bytes()


def looked_at(data: bytes, folder: Path) -> None:
    """Everything that reads a log, on such a file."""
    path, out = folder / "run.mcap", folder / "out.mcap"
    path.write_bytes(data)
    out.unlink(missing_ok=True)
    shutil.rmtree(folder / "tables", ignore_errors=True)
    lines: list[str] = []
    for look in (
        lambda: json.dumps(describe(open_log(path))),
        lambda: recover(path, out),
        lambda: replay(open_log(path)),
        lambda: export(open_log(path), folder / "tables", "csv", ["/tonus/state", "/can/can0"]),
    ):
        try:
            look()
        except ToolError as told:
            lines.append(str(told))
    assert all(str(folder) in line and "\n" not in line for line in lines)
    assert path.read_bytes() == data
    if out.exists():
        assert open_log(out).damage is None
        with out.open("rb") as stream:
            list(make_reader(stream, validate_crcs=True).iter_messages())


@QUIET
@given(share=st.floats(0.0, 1.0))
def test_a_file_cut_anywhere(whole: bytes, tmp_path: Path, share: float) -> None:
    looked_at(whole[: int(share * len(whole))], tmp_path)


@QUIET
@given(
    flips=st.lists(st.tuples(st.floats(0.0, 0.999999), st.integers(0, 7)), min_size=1, max_size=20)
)
def test_a_file_with_bits_turned(
    whole: bytes, tmp_path: Path, flips: list[tuple[float, int]]
) -> None:
    data = bytearray(whole)
    for share, bit in flips:
        data[int(share * len(data))] ^= 1 << bit
    looked_at(bytes(data), tmp_path)


@QUIET
@given(share=st.floats(0.0, 0.999), words=st.binary(min_size=8, max_size=8))
def test_a_file_with_a_forged_length(
    whole: bytes, tmp_path: Path, share: float, words: bytes
) -> None:
    at = int(share * len(whole))
    looked_at(whole[:at] + words + whole[at + 8 :], tmp_path)


def test_a_cut_summary_loses_nothing_and_says_so(whole: bytes, tmp_path: Path) -> None:
    path, out = tmp_path / "run.mcap", tmp_path / "out.mcap"
    path.write_bytes(whole[:-40])
    log = open_log(path)
    assert "every message is there" in str(log.damage)
    assert len(log["/tonus/timing"]) == TICKS
    salvage = recover(path, out)
    assert salvage is not None
    assert not salvage.lost
    assert np.array_equal(open_log(out)["/tonus/timing"], log["/tonus/timing"])


def test_what_stands_behind_a_damaged_chunk_is_recovered(whole: bytes, tmp_path: Path) -> None:
    path, out = tmp_path / "run.mcap", tmp_path / "out.mcap"
    path.write_bytes(whole)
    place = scan(path).chunks[3]
    data = bytearray(whole)
    data[place.offset + place.size // 2] ^= 16
    path.write_bytes(data)
    salvage = recover(path, out)
    assert salvage is not None
    assert salvage.chunks_lost == 1
    assert salvage.lost["/tonus/timing"] == 50
    assert salvage.complete
    ((start, end),) = salvage.holes
    assert end - start == pytest.approx(0.051)
    assert len(open_log(out)["/tonus/timing"]) == TICKS - 50
    assert recover(out, tmp_path / "again.mcap") is None, "what was recovered is whole"


def test_messages_before_the_cut_in_a_chunk_are_kept(tmp_path: Path) -> None:
    whole = record(tmp_path, TICKS, chunk_ms=250, compression="none").read_bytes()
    path, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    path.write_bytes(whole[: int(len(whole) * 0.4)])
    assert not len(open_log(path)["/tonus/timing"])
    assert recover(path, out) is not None
    assert np.array_equal(open_log(out)["/tonus/timing"]["tick"], np.arange(250))


def test_recovery_overwrites_nothing(whole: bytes, tmp_path: Path) -> None:
    path, out = tmp_path / "run.mcap", tmp_path / "out.mcap"
    path.write_bytes(whole[:-40])
    out.write_bytes(b"dear to somebody")
    with pytest.raises(ToolError, match="exists already"):
        recover(path, out)
    with pytest.raises(ToolError, match="exists already"):
        recover(path, path)
    assert out.read_bytes() == b"dear to somebody"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["out.mcap", "run.mcap"]


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunked", [True, False])
def test_the_file_of_another_program(
    tmp_path: Path, compression: CompressionType, chunked: bool
) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as stream:
        writer = Writer(
            stream,
            compression=compression,
            use_chunking=chunked,
            index_types=IndexType.ALL if chunked else IndexType.NONE,
        )
        writer.start("", "someone else")
        schema = writer.register_schema("thing", "jsonschema", b"{}")
        channel = writer.register_channel("/thing", "json", schema)
        for k in range(40):
            text = json.dumps({"k": k, "text": "x" * k}).encode()
            writer.add_message(channel, log_time=k, data=text, publish_time=k)
        writer.finish()
    log = open_log(path)
    assert log.damage is None
    assert [json.loads(each)["k"] for each in log["/thing"]] == list(range(40))
    assert describe(log)["topics"][0]["messages"] == 40
    for size in range(0, path.stat().st_size, 97):
        looked_at(path.read_bytes()[:size], tmp_path)


def test_a_chunk_that_claims_gigabytes_is_not_given_them(tmp_path: Path) -> None:
    path = tmp_path / "bomb.mcap"
    file = McapFile(path, "zstd")
    file.finish()
    content = zstandard.ZstdCompressor().compress(bytes(200_000_000))
    head = b"".join(n.to_bytes(8, "little") for n in (0, 0, 1000)) + bytes(4) + b"\4\0\0\0zstd"
    chunk = head + len(content).to_bytes(8, "little") + content
    start = path.read_bytes()[:60].index(b"\x0f")
    data = path.read_bytes()
    data = data[:start] + b"\x06" + len(chunk).to_bytes(8, "little") + chunk + data[start:]
    tracemalloc.start()
    looked_at(data, tmp_path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20_000_000


def test_the_commands_end_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "no.mcap").write_bytes(b"nothing")
    for name in ("info", "replay", "recover"):
        ended = CliRunner().invoke(command, [name, str(tmp_path / "no.mcap")])
        assert isinstance(ended.exception, ToolError)
        assert "is not an MCAP file" in str(ended.exception)


def test_damaged_metadata_is_told(whole: bytes, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    at = whole.index(b"cycle.ring\x01\x00\x00\x000") + len("cycle.ring") + 4
    path.write_bytes(whole[:at] + b"x" + whole[at + 1 :])
    log = open_log(path)
    assert "cycle.ring" not in log.recorded
    assert log.damage == "its account of lost records is damaged"
    assert json.dumps(describe(log))
