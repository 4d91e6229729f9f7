"""A run's log in the hands of others: the mcap package and rosbags read the same numbers."""

from __future__ import annotations

from pathlib import Path

import can
import cantools.database
import numpy as np
import pytest
from cantools.database.can import Database
from click.testing import CliRunner
from hil.runs import configured, virtual
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from runtime.signals import TOPICS
from tools.cli.export import export as export_command
from tools.log import Log
from tools.log.export import export


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    config, scenario = configured(duration=0.1)
    result, log = virtual(config, scenario, tmp_path_factory.mktemp("run"))
    assert not result.outcome.fault
    return log


def test_mcap_reads_it_with_every_checksum(log: Log) -> None:
    with log.path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        names = {channel.topic for channel in summary.channels.values()}
        assert {topic.name for topic in TOPICS} <= names
        count = sum(1 for _ in reader.iter_messages())
        assert count == summary.statistics.message_count
        attached = {item.name for item in reader.iter_attachments()}
        assert {"config.yaml", "scenario.yaml"} <= attached


@pytest.mark.parametrize("topic", ["/tonus/tension", "/tonus/drives", "/tonus/truth", "/can/can3"])
def test_rosbags_decodes_it_to_the_same_numbers(log: Log, topic: str) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    ours = log[topic]
    with log.path.open("rb") as stream:
        reader = make_reader(stream)
        number = 0
        for schema, _channel, message in reader.iter_messages(topics=[topic], log_time_order=False):
            assert schema is not None
            if number == 0:
                store.register(get_types_from_msg(schema.data.decode(), schema.name))
            if number % 97 == 0:
                decoded = store.deserialize_cdr(message.data, schema.name)
                row = ours[number]
                for name in row.dtype.names:
                    theirs = getattr(decoded, name, None)
                    if theirs is not None and name != "header":
                        assert np.array_equal(np.asarray(theirs), row[name]), name
            number += 1
    assert number == len(ours)


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
