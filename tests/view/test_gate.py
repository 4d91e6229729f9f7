"""Who reaches the viewer, and what it bears: strangers' pages, wrong tokens, floods."""

from __future__ import annotations

import http.client
import json
import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import msgspec.msgpack
import pytest
import viser
from viewer_bench import GOLDEN, TOKEN, Viewer, opened
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection

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


def _ended(connection: ClientConnection) -> int:
    """Wait for the end of a connection, and give its code; 1006 for an end without one."""
    try:
        while True:
            connection.recv(20)
    except ConnectionClosed as ended:
        return ended.rcvd.code if ended.rcvd else 1006


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
        assert _ended(connection)
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
        assert _ended(connection) == 1009


def test_a_flood_of_messages_ends_the_connection(viewer: Viewer) -> None:
    with viewer.connect() as connection:
        with suppress(ConnectionClosed):
            for _ in range(20 * settings().message_burst):
                connection.send('{"do": "alive"}')
        # What it had sent and nobody read may end the connection before the code arrives.
        assert _ended(connection) in (1006, 1008)
    _is_well(viewer)


def test_a_scene_takes_nothing_but_its_camera(viewer: Viewer) -> None:
    """viser opens a tunnel to the internet for whoever asks with this message."""
    protocol = f"viser-v{viser.__version__}"
    with viewer.connect("/scene", subprotocols=[protocol]) as connection:
        connection.send(msgspec.msgpack.encode({"type": "ShareUrlRequest"}))
        connection.send(msgspec.msgpack.encode({"type": "GuiCloseModalMessage", "uuid": "x"}))
        assert connection.recv(20)
        connection.send(b"\xc1 no message at all")
        assert _ended(connection)
    _is_well(viewer)


def test_much_sent_to_the_port_is_not_kept(viewer: Viewer) -> None:
    block = b"x" * (1 << 20)
    address = "127.0.0.1", viewer.port
    before = _memory(viewer)
    with socket.create_connection(address, 20) as connection, suppress(OSError):
        for _ in range(1024):
            connection.sendall(block)
    with socket.create_connection(address, 20) as connection, suppress(OSError):
        connection.sendall(b"GET / HTTP/1.1\r\n")
        for number in range(256):
            connection.sendall(b"Header%d: " % number + block + b"\r\n")
    assert _memory(viewer) - before < 50e6
    _is_well(viewer)


def test_a_thousand_connections_leave_it_alive(viewer: Viewer) -> None:
    idle = []
    for _ in range(1000):
        connection = socket.socket()
        connection.settimeout(5)
        with suppress(OSError):
            connection.connect(("127.0.0.1", viewer.port))
        idle.append(connection)
    for connection in idle:
        connection.close()
    for _ in range(40):
        with suppress(OSError, InvalidStatus, EOFError, TimeoutError):
            _is_well(viewer)
            break
    else:
        raise AssertionError("it serves no page any more")


def _memory(viewer: Viewer) -> float:
    """Bytes in use."""
    text = Path(f"/proc/{viewer.process.pid}/statm").read_text()
    return float(text.split()[1]) * 4096
