"""A log outlives the code that wrote it: it names no module and no source file of ours."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from loop import QUICK
from mcap.reader import make_reader

from tests.scripted import scripted
from tonus.tools.testing.player import Player

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("config", "drivers", "runtime", "sim", "tools")


def content(path: Path) -> Iterator[tuple[str, bytes]]:
    """All that a log holds, uncompressed, with the name of its place."""
    with path.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None
        for schema in summary.schemas.values():
            yield f"schema {schema.name}", schema.name.encode() + b" " + schema.data
        for each in reader.iter_metadata():
            yield f"metadata {each.name}", repr(each.metadata).encode()
        for attached in reader.iter_attachments():
            yield f"attachment {attached.name}", attached.data
        for _, channel, message in reader.iter_messages():
            yield f"message of {channel.topic}", message.data


@pytest.mark.tonus(config="config/direct.yaml", overrides=QUICK | {"recording.keyframe_s": 0.5})
@pytest.mark.wide
def test_a_log_names_no_module(tonus_run: Player) -> None:
    log = tonus_run(scripted(operator=[{"at": 1.5, "command": "stop"}])).log
    modules = [
        file.relative_to(ROOT).with_suffix("").as_posix()
        for room in ROOMS
        for file in (ROOT / room).rglob("*.py")
    ]
    names = "|".join(re.escape(name).replace("/", "[./]") for name in modules)
    named = re.compile(rf"\btonus\.(?:{'|'.join(ROOMS)})\b|\b(?:{names})\b".encode())
    assert named.search(b"see runtime/recording/keyframe.py")
    assert named.search(b"tonus.runtime.recording.keyframe")
    room = re.compile("|".join(ROOMS).encode())
    places = set()
    for place, data in content(log.path):
        # Most of it names no room, which is found sooner.
        found = room.search(data) and named.search(data)
        assert found is None, f"{place}: {found and found[0]!r}"
        places.add(place.split()[0])
    assert places == {"schema", "metadata", "attachment", "message"}
    assert len(log["/tonus/keyframe"]) > 1
