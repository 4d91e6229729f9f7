"""A file is there when it is whole, and not before."""

from __future__ import annotations

from pathlib import Path

import pytest

from tonus.tools.draft import drafted, write_whole


def test_what_fails_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    write_whole(path, "old")

    def fail() -> None:
        with drafted(path) as beside:
            beside.write_text("half of the n")
            assert path.read_text() == "old"
            raise OSError("no space")

    with pytest.raises(OSError, match="no space"):
        fail()
    assert path.read_text() == "old"
    write_whole(path, "new")
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_a_device_is_written_to() -> None:
    write_whole(Path("/dev/null"), "anything")
    assert not Path("/dev/null").is_file()
    with pytest.raises(OSError, match="No space"):
        write_whole(Path("/dev/full"), "anything")
