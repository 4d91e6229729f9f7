"""A run's log in the hands of others: the mcap package and rosbags read the same numbers."""

from __future__ import annotations

import numpy as np
import pytest
from hil.runs import configured, virtual
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from runtime.signals import TOPICS
from tools.log import Log


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
