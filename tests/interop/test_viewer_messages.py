"""The robot in standard messages: rosbags reads them with its own definitions of the types."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import numpy as np
import pytest
import synthetic_run
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tonus.config import load
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.recording.viewer import BASE, PLATFORM, Scene

TICKS = 200
TOPICS = ("/tf", "/viewer/pose", "/viewer/desired", "/viewer/winches", "/viewer/markers")
STORE = get_typestore(Stores.ROS2_HUMBLE)
TURN = np.array([np.cos(0.1), 0.0, 0.0, np.sin(0.1)])
"""0.2 rad about z, w first"""


@pytest.fixture(scope="module")
def rows() -> np.ndarray:
    rows = synthetic_run.cycles(TICKS)
    rows["pose"]["quaternion"] = TURN
    rows["pose"]["quaternion"][:40] = 0.0
    rows["pose"]["position"] = [0.01, 0.02, 0.03]
    rows["drives"]["angle"] = np.arange(8)
    rows["tension"]["measured"] = [1.0, 20.25, 45.0, 200.0, 500.0, 45.0, 45.0, 45.0]
    return rows


@pytest.fixture(scope="module")
def messages(rows: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Any]]:
    config, _ = load("config/can.yaml")
    folder = tmp_path_factory.mktemp("run")
    path = synthetic_run.record(folder, TICKS, rows=rows, scene=Scene.of(config))
    found: dict[str, list[Any]] = {topic: [] for topic in TOPICS}
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages(topics=list(TOPICS)):
            assert schema is not None
            assert len(message.data) % 4 == 0 or channel.topic == "/viewer/markers"
            decoded = STORE.deserialize_cdr(message.data, schema.name)
            found[channel.topic].append((message.log_time, decoded))
    return found


@pytest.mark.parametrize("topic", TOPICS)
def test_our_definitions_are_those_of_the_distribution(topic: str) -> None:
    from tonus.runtime.recording.viewer_messages import DEFINITIONS

    for name, definition in DEFINITIONS.items():
        for part, (_, fields) in get_types_from_msg(definition, name).items():
            theirs = [(field, kind) for field, kind in STORE.fielddefs[part][1]]
            assert [(field, kind) for field, kind in fields] == theirs, part


def test_there_is_one_every_thirtieth_of_a_second_once_there_is_a_pose(
    messages: dict[str, list[Any]],
) -> None:
    for each in messages.values():
        times = [stamp // 1_000_000 for stamp, _ in each]
        assert times == list(range(66, TICKS, 33))


def test_pose_and_transform_are_the_record_s(messages: dict[str, list[Any]]) -> None:
    stamp, pose = messages["/viewer/pose"][0]
    transform = messages["/tf"][0][1].transforms[0]
    assert pose.header.frame_id == transform.header.frame_id == BASE
    assert transform.child_frame_id == PLATFORM
    assert pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec == stamp
    for place in (pose.pose.position, transform.transform.translation):
        assert (place.x, place.y, place.z) == (0.01, 0.02, 0.03)
    for turned in (pose.pose.orientation, transform.transform.rotation):
        assert (turned.w, turned.z) == (TURN[0], TURN[3])


def test_winches_carry_their_angles_by_name(messages: dict[str, list[Any]]) -> None:
    joints = messages["/viewer/winches"][0][1]
    assert dict(zip(joints.name, joints.position, strict=True)) == {
        f"winch{number + 1}": float(number) for number in range(8)
    }
    assert len(joints.velocity) == len(joints.effort) == 8


def test_cables_are_drawn_between_their_anchors(messages: dict[str, list[Any]]) -> None:
    config, _ = load("config/can.yaml")
    cables = messages["/viewer/markers"][0][1].markers[2]
    points = np.array([(p.x, p.y, p.z) for p in cables.points]).reshape(8, 2, 3)
    kinematics = Kinematics(config.robot.geometry)
    kinematics.evaluate(np.array([0.01, 0.02, 0.03]), TURN)
    drawn = np.linalg.norm(points[:, 0] - points[:, 1], axis=1)
    assert drawn == pytest.approx(kinematics.lengths, abs=1e-12)


def test_a_slack_cable_is_black_and_colours_follow_the_tension(
    messages: dict[str, list[Any]],
) -> None:
    cables = messages["/viewer/markers"][0][1].markers[2]
    colours = np.array([(c.r, c.g, c.b) for c in cables.colors])[::2]
    assert not colours[0].any()
    low, middle, high, beyond = colours[1:5]
    assert low[2] > low[0]
    assert high[0] > high[2]
    assert np.ptp(middle) < 1e-6, "grey at pretension"
    assert np.array_equal(high, beyond)


def test_a_recorder_process_reads_the_scene_as_it_was_written() -> None:
    """JSON has lists for tuples; what is made once for a scene is found by it."""
    config, _ = load("config/can.yaml")
    scene = Scene.of(config)
    assert scene is not None
    read = Scene.read(json.loads(json.dumps(asdict(scene))))
    assert read == scene
    assert hash(read) == hash(scene)
