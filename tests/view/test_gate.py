"""Who reaches the viewer, and what it bears: strangers' pages, wrong tokens, floods."""

from __future__ import annotations

import http.client
import json
from collections.abc import Iterator
from contextlib import suppress

import msgspec.msgpack
import pytest
import viser
import zstandard
from viewer_bench import GOLDEN, TOKEN, Viewer, ended, opened
from websockets.exceptions import ConnectionClosed, InvalidStatus, NegotiationError
from websockets.typing import Subprotocol

from tonus.tools.view.settings import settings


@pytest.fixture(scope="module")
def viewer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Viewer]:
    made = Viewer(tmp_path_factory.mktemp("view"), str(GOLDEN), token=TOKEN)
    yield made
    made.close()


def _answer(viewer: Viewer, path: str, **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", viewer.port, timeout=20)
    connection.request("GET", path, headers=headers)
    return connection.getresponse()


def _is_well(viewer: Viewer) -> None:
    with opened(viewer) as page:
        assert page.next("now")["runs"]


@pytest.mark.parametrize("path", ["/channel", "/scene"])
@pytest.mark.parametrize("origin", ["http://elsewhere.example", "http://localhost:1", "null", None])
def test_a_page_from_elsewhere_gets_no_connection(
    viewer: Viewer, path: str, origin: str | None
) -> None:
    with pytest.raises(InvalidStatus) as refused:
        viewer.connect(path, origin=origin)
    assert refused.value.response.status_code == 403


@pytest.mark.parametrize("token", [None, "wrong", TOKEN[:-1], TOKEN + "x"])
@pytest.mark.parametrize("path", ["/channel", "/scene"])
def test_without_the_token_there_is_no_connection(
    viewer: Viewer, path: str, token: str | None
) -> None:
    with pytest.raises(InvalidStatus) as refused:
        viewer.connect(path, token=token)
    assert refused.value.response.status_code == 401


@pytest.mark.parametrize("path", ["/", "/page.js", "/scene/", "/scene/index.html"])
def test_without_the_token_there_is_no_page(viewer: Viewer, path: str) -> None:
    assert _answer(viewer, path).status == 401
    assert _answer(viewer, f"{path}?token=wrong").status == 401
    assert _answer(viewer, f"{path}?token={TOKEN}").status == 200


def test_a_foreign_name_that_leads_here_is_refused(viewer: Viewer) -> None:
    path = f"/?token={TOKEN}"
    assert _answer(viewer, path, Host=f"robot.example:{viewer.port}").status == 403
    assert _answer(viewer, path, Host="127.0.0.1").status == 403
    assert _answer(viewer, path, Host=f"localhost:{viewer.port}").status == 200


@pytest.mark.parametrize(
    "path", ["/../gate.py", "/scene/../../x", "/%2e%2e/gate.py", "/__init__.py"]
)
def test_no_other_file_is_served(viewer: Viewer, path: str) -> None:
    assert _answer(viewer, f"{path}?token={TOKEN}").status == 404


def test_pages_can_be_framed_by_nobody_else_and_run_no_other_script(viewer: Viewer) -> None:
    answer = _answer(viewer, f"/?token={TOKEN}")
    assert "default-src 'self'" in (answer.getheader("Content-Security-Policy") or "")
    assert answer.getheader("X-Frame-Options") == "SAMEORIGIN"
    assert "HttpOnly; SameSite=Strict" in (answer.getheader("Set-Cookie") or "")


def test_a_log_cannot_be_commanded(viewer: Viewer) -> None:
    with opened(viewer) as page:
        for verb in ("arm", "start", "estop"):
            reply = page.command(verb)
            assert not reply["ok"]
            assert "--operate" in reply["next"]
        assert not page.ask(do="lab", request={"op": "get"})["ok"]


@pytest.mark.parametrize("text", ["x", "[1]", "[" * 9000, '"a"', "\x00"])
def test_what_is_no_message_ends_the_connection(viewer: Viewer, text: str) -> None:
    with viewer.connect() as connection:
        connection.send(text)
        assert ended(connection)
    _is_well(viewer)


@pytest.mark.parametrize(
    "message",
    [
        {"do": "seek", "value": "x"},
        {"do": "seek", "value": float("inf")},
        {"do": "speed", "value": None},
        {"do": "choose", "signals": [1, None, "a.b", "state.nothing", "drives.rate[99]"]},
        {"do": "choose", "signals": "drives.rate[0]"},
        {"do": {}},
        {},
    ],
)
def test_a_senseless_message_does_nothing(viewer: Viewer, message: dict[str, object]) -> None:
    with opened(viewer) as page:
        page.connection.send(json.dumps(message))
        assert page.next("now")["runs"]
        assert page.next("points")["runs"]


def test_a_message_too_large_ends_the_connection(viewer: Viewer) -> None:
    with viewer.connect() as connection:
        with suppress(ConnectionClosed):
            connection.send("x" * (settings().message_bytes + 1))
        assert ended(connection) == 1009


def test_a_flood_of_messages_ends_the_connection(viewer: Viewer) -> None:
    with viewer.connect() as connection:
        with suppress(ConnectionClosed):
            for _ in range(20 * settings().message_burst):
                connection.send('{"do": "alive"}')
        # What it had sent and nobody read may end the connection before the code arrives.
        assert ended(connection) in (1006, 1008)
    _is_well(viewer)


def test_a_scene_answers_to_nothing_that_a_page_sends(viewer: Viewer) -> None:
    """viser's own server opens a tunnel to the internet for whoever asks with the first message."""
    protocol = f"viser-v{viser.__version__}"
    with viewer.connect("/scene", subprotocols=[protocol]) as connection:
        told = connection.recv(20)
        for message in ("ShareUrlRequest", "FileTransferStartUpload", "ViewerCameraMessage"):
            connection.send(msgspec.msgpack.encode({"type": message}))
        connection.send(b"\xc1 no message at all")
        connection.send("text")
        assert b"ReplayDone" in _unpacked(told)
        with opened(viewer) as page:  # the picture goes on, without an answer
            page.send(do="pause")
            for moment in (4.0, 0.0, 1.0, 0.0):
                page.send(do="seek", value=moment)
                page.until(lambda now, at=moment: abs(now["t"] - at) < 0.1)  # type: ignore[misc]
        frames = []
        with suppress(TimeoutError):
            while True:
                frames.append(_unpacked(connection.recv(1.0)))
        assert frames
        assert b"Share" not in b"".join(frames)
    _is_well(viewer)


def _unpacked(frame: str | bytes) -> bytes:
    assert isinstance(frame, bytes)
    return zstandard.decompress(frame[16 : 16 + int.from_bytes(frame[8:16], "little")])


def test_a_flood_at_a_scene_ends_its_connection(viewer: Viewer) -> None:
    protocol = f"viser-v{viser.__version__}"
    with viewer.connect("/scene", subprotocols=[protocol]) as connection:
        with suppress(ConnectionClosed):
            for _ in range(20 * settings().message_burst):
                connection.send(b"\x80")
        assert ended(connection) in (1006, 1008)
    _is_well(viewer)


@pytest.mark.parametrize("offered", [None, ["viser-v1.0.0"], ["viser-v2.0.0"], ["chat"]])
def test_a_scene_speaks_to_its_own_client_only(
    viewer: Viewer, offered: list[Subprotocol] | None
) -> None:
    with suppress(NegotiationError), viewer.connect("/scene", subprotocols=offered) as connection:
        assert ended(connection) == 1002
    _is_well(viewer)
