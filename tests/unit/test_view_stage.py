"""What is told to viser's client: the same as viser itself tells it, and to every page in order."""

from __future__ import annotations

import asyncio
import io
import json
from collections.abc import Iterator
from contextlib import redirect_stdout
from types import SimpleNamespace
from typing import Any, cast

import msgspec.msgpack
import numpy as np
import pytest
import viser
import zstandard
from websockets.exceptions import ConnectionClosedOK
from websockets.frames import Close

from tonus.config.loader import load
from tonus.runtime.signals import cycle_dtype
from tonus.runtime.states import State
from tonus.sim.lab.truth import truth_dtype
from tonus.tools.errors import ToolError
from tonus.tools.view import client
from tonus.tools.view.client import SPOKEN, client_file, encoded
from tonus.tools.view.colours import TINTS
from tonus.tools.view.moment import Samples
from tonus.tools.view.scene import RobotScene
from tonus.tools.view.shape import Shape
from tonus.tools.view.stage import Stage

Told = dict[str, dict[str, Any]]
NOT_ASKED_FOR = (
    "/WorldAxes",
    "GuiSetPanelPositionMessage",
    "GuiSetPanelWidthMessage",
    "GuiSetPanelHeightMessage",
    "SetGuiPanelLabelMessage",
    "BackgroundImageMessage",
)
"""what viser tells every page beside the scene, all of it the client's own default or nothing"""


@pytest.fixture(scope="module")
def viser_server() -> Iterator[viser.ViserServer]:
    with redirect_stdout(io.StringIO()):
        server = viser.ViserServer("127.0.0.1", 0, verbose=False)
        yield server
        server.stop()


def _shape(name: str = "config/can.yaml", scenario: str = "contact") -> Shape:
    config, chosen = load(name, scenario)
    return Shape.of(config.model_dump(mode="json"), chosen.model_dump(mode="json"))


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.tolist()
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    return list(value) if isinstance(value, tuple) else value


def _by_place(messages: list[dict[str, Any]]) -> Told:
    """By what each is about: its kind, its node, and the property that it changes."""
    found = {}
    for message in messages:
        changed = ",".join(message.get("updates", {}))
        found[f"{message['type']} {message.get('name', '')} {changed}"] = _plain(message)
    return found


def _of_viser(server: viser.ViserServer) -> Told:
    """What it would tell a page that opens now."""
    told = []
    for message in server._websock_server._broadcast_buffer.message_from_id.values():
        arrays: list[memoryview] = []
        one = message.as_serializable_dict(arrays)
        told.append(_with_arrays(one, arrays))
    return _by_place([one for one in told if not _is_not_asked_for(one)])


def _is_not_asked_for(message: dict[str, Any]) -> bool:
    return message["type"] in NOT_ASKED_FOR or message.get("name") in NOT_ASKED_FOR


def _with_arrays(value: Any, arrays: list[Any]) -> Any:
    if not isinstance(value, dict):
        return value
    if "__binary_index" in value:
        return np.frombuffer(arrays[value["__binary_index"]], value["dtype"])
    return {key: _with_arrays(each, arrays) for key, each in value.items()}


def _decoded(frame: bytes) -> list[dict[str, Any]]:
    """As the client does (viser, BinaryMessageDecode.ts)."""
    length, packed = (int.from_bytes(frame[at : at + 8], "little") for at in (0, 8))
    inner = zstandard.decompress(frame[16 : 16 + packed])
    assert len(inner) == length
    told = msgspec.msgpack.decode(inner)
    at, arrays = 16 + packed, []
    for size in told["binaryBufferLengths"]:
        at += -at % 8
        arrays.append(frame[at : at + size])
        at += size
    assert at == len(frame)
    return [_with_arrays(message, arrays) for message in told["messages"]]


class Connection:
    """A page that reads as soon as it may, and says nothing."""

    def __init__(self, subprotocol: str = f"{SPOKEN}1") -> None:
        self.subprotocol = subprotocol
        self.frames: list[list[dict[str, Any]]] = []
        self.may_read, self.gone = asyncio.Event(), asyncio.Event()
        self.code = 0

    async def send(self, frame: bytes) -> None:
        await self.may_read.wait()
        self.frames.append(_decoded(frame))

    async def close(self, code: int, reason: str) -> None:
        assert reason
        self.code = code

    def __aiter__(self) -> Connection:
        return self

    async def __anext__(self) -> bytes:
        await self.gone.wait()
        raise ConnectionClosedOK(Close(1000, ""), None)


async def _settle() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


def _opened(stage: Stage) -> list[dict[str, Any]]:
    """What a page is told that opens now, without the mark at its end."""

    async def opened() -> list[dict[str, Any]]:
        page = Connection()
        page.may_read.set()
        serving = asyncio.create_task(stage.serve(cast(Any, page)))
        await _settle()
        page.gone.set()
        await serving
        (frame,) = page.frames
        assert frame[-1] == {"type": "ReplayDoneMessage"}
        return frame[:-1]

    return asyncio.run(opened())


def _records(shape: Shape) -> list[tuple[Any, Any, Samples]]:
    """Moments in which everything moves, shows and hides."""
    some = np.random.default_rng(1)
    found = []
    for number, state in enumerate((State.STANDBY, State.HOLD, State.ACTIVE, State.FAULT)):
        record = np.zeros(1, cycle_dtype(shape.cables))
        true = np.zeros(1, truth_dtype(shape.cables))
        turned = some.normal(size=4)
        record["pose"]["quaternion"] = turned / np.linalg.norm(turned)
        for field in ("position", "desired_position"):
            record["pose"][field] = some.uniform(-0.1, 0.1, 3)
        record["state"]["state"] = state
        record["tension"]["measured"] = some.uniform(0.0, 90.0, shape.cables)
        record["drives"]["angle"] = some.uniform(-3.0, 3.0, shape.cables)
        record["wrench"]["external"][0, :3] = some.normal(size=3) * 20.0 * number
        record["wrench"]["contact"] = 5.0 * number
        true["position"] = record["pose"]["position"] + 0.01 * (number % 2)
        true["quaternion"][0, 0] = 1.0
        rows = np.repeat(record, 3)
        rows["pose"]["desired_position"] += some.uniform(-0.01, 0.01, (3, 3))
        found.append((record, true, Samples(np.arange(3.0) + 3.0 * number, rows)))
    return found


@pytest.mark.parametrize("config", ["config/can.yaml", "config/six.yaml", "config/twelve.yaml"])
def test_a_robot_is_told_as_viser_tells_it(viser_server: viser.ViserServer, config: str) -> None:
    """Its own server, given the same calls, is what its client was made for."""
    server, stage, shape = viser_server, Stage(), _shape(config)
    names = [name for name in dir(server.scene) if name.startswith("add_")]
    calls = {name: getattr(server.scene, name) for name in names}
    its_own = cast(Stage, SimpleNamespace(atomic=server.atomic, **calls))
    server.scene.reset()
    server.scene.set_up_direction("+z")
    server.scene.configure_default_lights(enabled=True, cast_shadow=False)
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.gui.main_panel.minimize()
    stage.look((1.7, -2.1, 1.0), at=(0.0, 0.0, 0.1))
    server.initial_camera.position = (1.7, -2.1, 1.0)
    server.initial_camera.look_at = (0.0, 0.0, 0.1)
    name = f"/{config}".replace(".", "-")
    drawn = [
        RobotScene(given, shape, name=f"{name}/{number}", tint=tint)
        for given in (stage, its_own)
        for number, tint in enumerate((None, TINTS[0]))
    ]
    for moment in (None, *_records(shape)):
        if moment is not None:
            for scene in drawn:
                newest, true, samples = moment
                scene.show(newest, true, samples, jumped=False)
                scene.show_ahead(samples.rows["pose"]["desired_position"])
        ours, its = _by_place(_opened(stage)), _of_viser(server)
        its = {key: one for key, one in its.items() if not key.startswith("RemoveSceneNode")}
        for told in (ours, its):
            (panel,) = (key for key in told if key.startswith("GuiSetPanelCollapsed"))
            assert told[panel].pop("run_id")
            assert told[panel].pop("counter")
        assert sorted(ours) == sorted(its)
        for key, one in its.items():
            _same(ours[key], one, key)


def _same(ours: Any, its: Any, where: str) -> None:
    """viser does not tell a pose that is hardly another."""
    if isinstance(its, dict):
        assert ours.keys() == its.keys(), where
        for key in its:
            _same(ours[key], its[key], f"{where} {key}")
    elif isinstance(its, list | tuple) and its and not isinstance(its[0], str):
        assert np.allclose(np.ravel(ours), np.ravel(its), atol=1e-6), where
    elif isinstance(its, tuple):
        assert ours[0] == its[0], where
        assert np.allclose(np.ravel(ours[1]), np.ravel(its[1]), atol=1e-6), where
    elif isinstance(its, float):
        assert ours == pytest.approx(its), where
    else:
        assert ours == its, where


def test_arrays_come_to_a_client_as_they_are() -> None:
    """The client takes each where it lies, and so at a multiple of eight bytes."""
    some = np.random.default_rng(2)
    sent: list[dict[str, Any]] = []
    for size in range(1, 9):
        props = {"a": some.integers(0, 9, size, np.uint8), "b": some.normal(size=(size, 2, 3))}
        sent.append({"type": "x", "name": "é", "props": props | {"c": None, "d": (1.0, 2)}})
    assert json.dumps([_plain(one) for one in _decoded(encoded(sent))]) == json.dumps(
        [{**one, "props": _plain({**one["props"], "b": one["props"]["b"].ravel()})} for one in sent]
    )


def test_a_page_is_told_what_stands_and_then_what_changes_in_one_picture() -> None:
    stage = Stage()
    node = stage.add_box("/a/b", (1, 2, 3), (1.0, 1.0, 1.0))

    async def play() -> list[list[dict[str, Any]]]:
        page = Connection()
        page.may_read.set()
        serving = asyncio.create_task(stage.serve(cast(Any, page)))
        await _settle()
        node.position = (2.0, 0.0, 0.0)  # for which the page is awake already
        with stage.atomic():
            node.position = (1.0, 0.0, 0.0)
            await _settle()
            node.visible = False
        await _settle()
        node.visible = False  # as it is already
        node.position = np.array((1.0, 0.0, 0.0))
        await _settle()
        page.gone.set()
        await serving
        return page.frames

    first, second = asyncio.run(play())
    assert [one["name"] for one in first if one["type"].endswith("FrameMessage")] == ["/a"]
    assert [one["type"] for one in second] == [
        "SetPositionMessage",
        "SetSceneNodeVisibilityMessage",
    ]


def test_a_page_that_reads_slowly_is_told_the_newest_and_no_more() -> None:
    stage = Stage()
    node = stage.add_frame("/a")

    async def play() -> list[list[dict[str, Any]]]:
        page = Connection()
        serving = asyncio.create_task(stage.serve(cast(Any, page)))
        await _settle()
        for step in range(1000):
            node.position = (float(step), 0.0, 0.0)
            await _settle()
        page.may_read.set()
        await _settle()
        page.gone.set()
        await serving
        return page.frames

    first, second = asyncio.run(play())
    assert first[-1]["type"] == "ReplayDoneMessage"
    (last,) = second
    assert last["position"] == [999.0, 0.0, 0.0]


def test_what_is_taken_away_goes_from_open_pages_and_is_not_told_to_later_ones() -> None:
    stage = Stage()
    stage.look((1.0, 1.0, 1.0), at=(0.0, 0.0, 0.0))
    surroundings = _opened(stage)[:-2]
    stage.add_box("/1/a", (1, 2, 3), (1.0, 1.0, 1.0)).position = (1.0, 1.0, 1.0)

    async def play() -> list[list[dict[str, Any]]]:
        page = Connection()
        page.may_read.set()
        serving = asyncio.create_task(stage.serve(cast(Any, page)))
        await _settle()
        stage.clear()
        await _settle()
        page.gone.set()
        await serving
        return page.frames

    _, second = asyncio.run(play())
    assert {(one["type"], one["name"]) for one in second} == {
        ("RemoveSceneNodeMessage", "/1"),
        ("RemoveSceneNodeMessage", "/1/a"),
    }
    assert _opened(stage) == surroundings


def test_a_page_that_has_not_read_yet_is_told_last_what_is_gone() -> None:
    """What is told of a node after it is gone would make the client look for it."""
    stage = Stage()
    stage.add_box("/1/a", (1, 2, 3), (1.0, 1.0, 1.0))

    async def play() -> list[dict[str, Any]]:
        page = Connection()
        page.may_read.set()
        serving = asyncio.create_task(stage.serve(cast(Any, page)))
        with stage.atomic():
            await _settle()
            stage.clear()
        await _settle()
        page.gone.set()
        await serving
        (frame,) = page.frames
        return frame

    told = [one["type"] for one in asyncio.run(play())]
    assert told[-2:] == ["RemoveSceneNodeMessage"] * 2
    assert "FrameMessage" not in told


def test_a_client_of_another_version_is_sent_away() -> None:
    page = Connection("viser-v2.0.0")
    asyncio.run(Stage().serve(cast(Any, page)))
    assert page.code == 1002
    assert not page.frames


def test_a_viser_of_another_version_is_refused_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    assert b"<html" in client_file()
    client_file.cache_clear()
    monkeypatch.setattr(client, "version", lambda _: "1.2.0")
    with pytest.raises(ToolError, match=r"draws with viser 1\.1, and viser 1\.2\.0 is installed"):
        client_file()
    monkeypatch.setattr(client, "find_spec", lambda _: None)
    with pytest.raises(ToolError, match=r"needs the package viser"):
        client_file()
