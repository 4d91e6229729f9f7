"""The topics as Foxglove sees them, by a plain WebSocket client that knows its protocol only."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from viewer_bench import ROOT, Served, Viewer, free_port
from websockets.sync.client import ClientConnection, connect

from tonus.runtime.signals import topics

pytestmark = pytest.mark.wide

TOKEN = "a-token-for-foxglove"  # noqa: S105
_MESSAGE, _REPLY = 1, 3
_HEADER = bytes((0, 1, 0, 0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("foxglove")


@pytest.fixture(scope="module")
def daemon(folder: Path) -> Iterator[Served]:
    made = Served(folder, "config/direct.yaml", "--virtual")
    yield made
    made.close()


@pytest.fixture(scope="module")
def port(daemon: Served, folder: Path) -> Iterator[int]:
    number = free_port()
    made = Viewer(folder, "--operate", "--foxglove", str(number), token=TOKEN)
    yield number
    made.close()


class Client:
    def __init__(self, connection: ClientConnection) -> None:
        self.connection = connection
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        while not (self.channels and self.services):
            message = connection.recv(20)
            if isinstance(message, str):
                told = json.loads(message)
                if told["op"] == "advertise":
                    self.channels |= {each["topic"]: each for each in told["channels"]}
                elif told["op"] == "advertiseServices":
                    self.services |= {each["name"]: each for each in told["services"]}

    def messages(self, topic: str, count: int) -> list[tuple[int, bytes]]:
        """Stamps in ns, and messages."""
        wanted = [{"id": 7, "channelId": self.channels[topic]["id"]}]
        self.connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        found: list[tuple[int, bytes]] = []
        while len(found) < count:
            data = self.connection.recv(20)
            if isinstance(data, bytes) and data[0] == _MESSAGE:
                number, stamp = struct.unpack_from("<IQ", data, 1)
                assert number == 7
                found.append((stamp, data[13:]))
        return found

    def call(self, **request: Any) -> dict[str, Any]:
        payload, encoding = json.dumps(request).encode(), b"json"
        service = self.services["/tonus/command"]["id"]
        head = struct.pack("<BIII", 2, service, 1, len(encoding))
        self.connection.send(head + encoding + payload)
        while True:
            data = self.connection.recv(20)
            if isinstance(data, bytes) and data[0] == _REPLY:
                size = struct.unpack_from("<I", data, 9)[0]
                return dict(json.loads(data[13 + size :]))


@pytest.fixture
def client(port: int) -> Iterator[Client]:
    address = f"ws://127.0.0.1:{port}"
    protocols: Any = ["foxglove.sdk.v1", "foxglove.websocket.v1"]
    with connect(address, subprotocols=protocols, max_size=None) as connection:
        yield Client(connection)


def test_every_topic_of_the_record_has_its_schema(client: Client) -> None:
    for topic in topics(8):
        told = client.channels[topic.name]
        assert told["encoding"] == "cdr"
        assert told["schemaEncoding"] == "ros2msg"
        assert told["schemaName"] == topic.message
        assert told["schema"] == topic.definition
    assert {"/tonus/truth", "/tonus/events", "/tf", "/viewer/markers"} <= client.channels.keys()


def test_messages_are_the_bytes_of_the_log(client: Client) -> None:
    topic = next(each for each in topics(8) if each.name == "/tonus/timing")
    found = client.messages("/tonus/timing", 20)
    ticks = []
    for stamp, message in found:
        assert message[:4] == _HEADER
        row = np.frombuffer(message[4:], topic.dtype)
        assert len(row) == 1
        assert stamp == row["due_ns"][0]
        ticks.append(int(row["tick"][0]))
    assert np.unique(np.diff(ticks)).tolist() == [10]


def test_an_armed_robot_comes_as_a_picture_too(client: Client) -> None:
    assert client.call(verb="arm", token=TOKEN)["ok"]
    assert len(client.messages("/viewer/winches", 3)) == 3
    assert client.call(verb="estop", token=TOKEN)["state"] == "FAULT"
    assert client.call(verb="reset", token=TOKEN)["ok"]


@pytest.mark.parametrize("token", [None, "wrong", ""])
def test_a_command_without_the_right_is_refused(client: Client, token: str | None) -> None:
    given = {} if token is None else {"token": token}
    reply = client.call(verb="arm", **given)
    assert not reply["ok"]
    assert "token" in reply["error"]


def test_a_command_with_the_right_is_carried_out(client: Client) -> None:
    assert client.call(verb="status", token=TOKEN)["state"] == "STANDBY"
    refused = client.call(verb="start", token=TOKEN)
    assert not refused["ok"]
    assert "STANDBY" in refused["error"]


def test_who_only_looks_commands_nothing(daemon: Served, folder: Path) -> None:
    number = free_port()
    made = Viewer(folder, "--foxglove", str(number))
    protocols: Any = ["foxglove.sdk.v1"]
    try:
        with connect(
            f"ws://127.0.0.1:{number}", subprotocols=protocols, max_size=None
        ) as connection:
            reply = Client(connection).call(verb="estop", token="")
        assert not reply["ok"]
        assert "--operate" in reply["next"]
    finally:
        made.close()


def test_the_layout_names_topics_and_fields_that_are_there(client: Client) -> None:
    layout = json.loads((ROOT / "docs" / "foxglove_layout.json").read_text())
    paths = _paths(layout["configById"])
    assert len(paths) > 8
    fields = {topic.name: {field.name for field in topic.fields} for topic in topics(8)}
    for path in paths:
        topic, _, field = path.partition(".")
        assert topic in client.channels, path
        if topic in fields and field:
            assert field.split("[")[0] in fields[topic], path


def _paths(node: Any) -> list[str]:
    if isinstance(node, dict):
        found = [path for value in node.values() for path in _paths(value)]
        named = [node[key] for key in ("topicPath", "value", "path") if key in node]
        named += [key for key in node if key.startswith("/")]
        return found + [each for each in named if isinstance(each, str) and each.startswith("/")]
    return [path for each in node for path in _paths(each)] if isinstance(node, list) else []
