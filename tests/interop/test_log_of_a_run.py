"""A run's log in the hands of others: the mcap package and rosbags read the same numbers."""

from __future__ import annotations

from pathlib import Path

import can
import cantools.database
import numpy as np
import pytest
from cantools.database.can import Database
from click.testing import CliRunner
from loop import QUICK
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tonus.runtime.signals import TABLE
from tonus.tools.cli.export import export as export_command
from tonus.tools.log import Log
from tonus.tools.log.export import export
from tonus.tools.testing.player import Player

pytestmark = pytest.mark.tonus(overrides=QUICK)


@pytest.fixture(scope="module")
def log(tonus_shared_run: Player) -> Log:
    return tonus_shared_run("hold", duration=0.1).log


@pytest.mark.wide
def test_mcap_reads_it_with_every_checksum(log: Log) -> None:
    with log.path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        names = {channel.topic for channel in summary.channels.values()}
        assert {topic.name for topic in TABLE} <= names
        count = sum(1 for _ in reader.iter_messages())
        assert count == summary.statistics.message_count
        attached = {item.name for item in reader.iter_attachments()}
        assert {"config.yaml", "scenario.yaml"} <= attached


@pytest.mark.wide
def test_rosbags_decodes_every_topic_to_the_same(log: Log) -> None:
    """Also those of no fixed size, which our library leaves as they are encoded."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    known: set[str] = set()
    counted = dict.fromkeys(log.topics, 0)
    with log.path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            topic, number = channel.topic, counted[channel.topic]
            counted[topic] += 1
            if number % 97 and number % 7919:
                continue
            if schema.name not in known:
                known.add(schema.name)
                store.register(get_types_from_msg(schema.data.decode(), schema.name))
            theirs, ours = store.deserialize_cdr(message.data, schema.name), log[topic][number]
            assert log.times(topic)[number] == message.log_time
            if isinstance(ours, bytes):
                assert ours == bytes(message.data), topic
                continue
            for name in ours.dtype.names:
                if name in ("sec", "nanosec"):
                    assert getattr(theirs.header.stamp, name) == ours[name]
                    continue
                value = np.asarray(getattr(theirs, name))
                if isinstance(ours[name], bytes):
                    assert value.astype(np.uint8).tobytes() == ours[name], f"{topic}.{name}"
                else:
                    assert np.array_equal(value, ours[name]), f"{topic}.{name}"
    assert counted == {topic: len(log[topic]) for topic in log.topics}
    expected = {"/tf", "/viewer/pose", "/viewer/markers", "/tonus/keyframe", "/tonus/events"}
    assert expected | {"/can/can0", "/tonus/truth"} <= {t for t in counted if counted[t]}


def test_exported_frames_decode_with_the_exported_dbc(log: Log, tmp_path: Path) -> None:
    made = CliRunner().invoke(
        export_command, ["dbc", "config/can.yaml", "--out", str(tmp_path / "x.dbc")]
    )
    assert made.exit_code == 0, made.output
    database = cantools.database.load_file(tmp_path / "x.dbc")
    assert isinstance(database, Database)
    export(log, tmp_path, "blf")
    forces, decoded = [], 0
    with can.LogReader(tmp_path / "run.blf") as reader:
        for frame in reader:
            message = database.get_message_by_frame_id(frame.arbitration_id)
            if frame.dlc == message.length and message.signals:
                told = message.decode(frame.data)
                decoded += 1
                if message.name == "Cell1_TPDO1":
                    forces.append(told["Force"])
    assert decoded > 20 * len(log["/tonus/timing"])
    measured = log["/tonus/force_cells"]["raw"][:, 1]
    assert np.isin(np.round(forces, 9), np.round(measured, 9)).mean() > 0.99
