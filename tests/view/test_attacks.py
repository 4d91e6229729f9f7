"""Attacks at the viewer of a robot that holds its place: nothing is commanded, the daemon goes on.

The robot is served in virtual time and armed by its operator. Each attack runs beside it, against
a viewer that may command; at the end the log tells what the robot got.
"""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from viewer_bench import Page, Served, Viewer, ended, opened
from websockets.exceptions import ConnectionClosed, InvalidMessage, InvalidStatus

from tonus.runtime.states import State
from tonus.runtime.timing import clock
from tonus.tools.log import open as open_log
from tonus.tools.view.settings import settings

pytestmark = pytest.mark.wide

TOKEN = "a-token-for-attacks"  # noqa: S105
GIGABYTE = 1 << 30
BLOCK = b"x" * (1 << 20)
MORE_MEMORY = 50e6
"""bytes that the viewer may take for a while: its buffers, for as many connections as it bears"""
ORDERS = [
    {"do": "command", "verb": "estop", "id": 1},
    {"do": "command", "verb": "stop", "id": 2},
    {"do": "lab", "request": {"op": "inject", "fault": {"kind": "tracker_hidden"}}, "id": 3},
]
"""each of which would end what the robot does"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("attacked")


@pytest.fixture(scope="module")
def viewer(folder: Path) -> Iterator[Viewer]:
    """Of a robot in HOLD. After the last attack its log holds the operator's commands only."""
    daemon = Served(folder, "config/direct.yaml", "--virtual")
    made = Viewer(folder, "--operate", token=TOKEN)
    try:
        with opened(made) as operator:
            operator.arm()
        yield made
        with opened(made) as operator:
            told = operator.until(lambda now: "status" in now)["status"]
            orders = [each["text"] for each in operator.events if each["name"] == "operator"]
    finally:
        made.close()
        daemon.close()
    assert told["state"] == "HOLD"
    assert told["fault"] is None
    assert [order.split()[0] for order in orders] == ["arm"]
    _is_undisturbed(next((folder / "out").glob("*/run.mcap")))


def _is_undisturbed(path: Path) -> None:
    """To its end, which is ours: the robot held without a gap in its record."""
    log = open_log(path)
    ticks, states = log["/tonus/timing"]["tick"], log["/tonus/state"]["state"]
    assert np.unique(np.diff(ticks.astype(np.int64))).tolist() == [1]
    held = np.flatnonzero(states == State.HOLD)
    assert np.unique(np.diff(held)).tolist() == [1]
    orders = [each.text for each in log.events() if each.name == "operator"]
    assert {order.split()[0] for order in orders} <= {"arm", "stop"}
    assert not (log["/tonus/state"]["fault"] != 0).any()


@pytest.fixture
def witness(viewer: Viewer) -> Iterator[Page]:
    """The operator's page. After the attack ticks have gone on, and no event has come."""
    with opened(viewer) as page:
        before = page.next("now")["runs"][0]
        events = len(page.events)
        yield page
    with opened(viewer) as page:
        after = page.until(lambda now: now["runs"][0]["tick"] > before["tick"] + 100)["runs"][0]
        assert before["state"] == after["state"] == "HOLD"
        assert len(page.events) == events


@pytest.mark.parametrize("origin", ["http://elsewhere.example", "http://localhost:1", "null", None])
@pytest.mark.parametrize("path", ["/channel", "/scene"])
def test_a_page_from_elsewhere_commands_nothing(
    viewer: Viewer, witness: Page, origin: str | None, path: str
) -> None:
    """Its browser sends the cookie of the operator too: the Origin alone tells it."""
    _is_refused(viewer, 403, path=path, origin=origin)


@pytest.mark.parametrize("token", [None, "wrong", TOKEN[:-1], TOKEN + "x", TOKEN.upper()])
def test_a_wrong_token_commands_nothing(viewer: Viewer, witness: Page, token: str | None) -> None:
    _is_refused(viewer, 401, token=token)


def _is_refused(viewer: Viewer, status: int, **given: str | None) -> None:
    status_code = 0
    try:
        with viewer.connect(**given) as connection:
            for order in ORDERS:
                connection.send(json.dumps(order))
            connection.recv(20)
    except InvalidStatus as refused:
        status_code = refused.response.status_code
    assert status_code == status


def test_orders_sent_before_an_answer_are_not_carried_out(viewer: Viewer, witness: Page) -> None:
    """Behind the request for a connection, which will be refused, in the same bytes."""
    frames = b"".join(
        bytes((0x81, 0x80 | len(text), 0, 0, 0, 0)) + text
        for order in ORDERS
        for text in [json.dumps(order).encode()]
        if len(text) < 126
    )
    assert frames
    request = (
        f"GET /channel HTTP/1.1\r\nHost: 127.0.0.1:{viewer.port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
        f"Sec-WebSocket-Version: 13\r\nOrigin: {viewer.origin}\r\n\r\n"
    )
    with socket.create_connection(("127.0.0.1", viewer.port), 20) as connection:
        connection.sendall(request.encode() + frames)
        assert b" 401 " in connection.recv(4096).split(b"\r\n")[0]


@pytest.mark.parametrize("head", [b"", b"GET / HTTP/1.1\r\nA: ", b"POST / HTTP/1.1\r\n\r\n"])
def test_a_gigabyte_sent_to_the_port_is_not_kept(
    viewer: Viewer, witness: Page, head: bytes
) -> None:
    """Each connection ends soon; the next one goes on where it ended."""
    before, sent = viewer.memory(), 0
    while sent < GIGABYTE:
        with socket.socket() as connection, suppress(OSError):
            connection.settimeout(20)
            connection.connect(("127.0.0.1", viewer.port))
            connection.sendall(head)
            # All that the kernel takes; what the viewer has not read when it closes is lost.
            while sent < GIGABYTE:
                sent += connection.send(BLOCK)
    assert viewer.peak() - before < MORE_MEMORY


def test_a_gigabyte_in_one_message_is_not_kept(viewer: Viewer, witness: Page) -> None:
    """In fragments, each of which is short enough."""
    before, sent = viewer.memory(), 0

    def parts() -> Iterator[bytes]:
        nonlocal sent
        while sent < GIGABYTE:
            sent += 1 << 15
            yield BLOCK[: 1 << 15]

    with viewer.connect() as connection:
        with suppress(ConnectionClosed):
            connection.send(parts())
        assert ended(connection) == 1009
    assert viewer.peak() - before < MORE_MEMORY


def test_a_thousand_connections_leave_the_operator_in_command(
    viewer: Viewer, witness: Page
) -> None:
    """Whose page was open before, and is still answered in the middle of them."""
    before, idle = viewer.memory(), []
    try:
        for number in range(1000):
            connection = socket.socket()
            connection.settimeout(5)
            with suppress(OSError):
                connection.connect(("127.0.0.1", viewer.port))
            idle.append(connection)
            if number % 250 == 249:
                assert witness.command("status")["state"] == "HOLD"
                # What is too many is closed as soon as the server comes to it.
                for _ in range(200):
                    kept = sum(map(_is_open, idle))
                    if kept <= settings().connections:
                        break
                    clock.pause(0.05)
                assert kept <= settings().connections
    finally:
        for connection in idle:
            connection.close()
    _is_well(viewer)
    assert viewer.peak() - before < MORE_MEMORY


def _is_open(connection: socket.socket) -> bool:
    """Whether the viewer keeps it: it sends nothing to one that has asked nothing."""
    connection.setblocking(False)
    try:
        return connection.recv(1) != b""
    except BlockingIOError:
        return True
    except OSError:
        return False


def test_slow_connections_are_ended_and_keep_no_page_out(viewer: Viewer, witness: Page) -> None:
    """A header a second, never the last one: each connection has `handshake_s` in all."""
    slow = []
    for _ in range(settings().connections // 2):
        connection = socket.create_connection(("127.0.0.1", viewer.port), 20)
        connection.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{viewer.port}\r\n".encode())
        slow.append(connection)
    over = threading.Event()

    def drip() -> None:
        number = 0
        while not over.wait(0.5):
            number += 1
            for connection in slow:
                with suppress(OSError):
                    connection.sendall(b"X-%d: y\r\n" % number)

    dripping = threading.Thread(target=drip)
    dripping.start()
    try:
        _is_well(viewer)
        for connection in slow:
            connection.settimeout(10 * settings().handshake_s)
            with suppress(ConnectionResetError):
                while connection.recv(4096):
                    pass
    finally:
        over.set()
        dripping.join()
        for connection in slow:
            connection.close()


def _is_well(viewer: Viewer) -> None:
    """It serves a page, at the latest when the connections of an attack have ended."""
    for _ in range(40):
        with suppress(OSError, InvalidStatus, InvalidMessage, EOFError, TimeoutError):
            with opened(viewer) as page:
                assert page.next("now")["runs"]
            return
        clock.pause(0.25)
    raise AssertionError("it serves no page any more")
