"""A lab in its own process, asked through its door by another."""

from __future__ import annotations

import json
import os
import socket
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest

pytestmark = pytest.mark.realtime

NOBODY = 65534


def start(directory: Path, *arguments: str) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-m", "tonus.tools.cli", "lab", "config/can.yaml", *arguments],
        env={**os.environ, "TONUS_RUNTIME_DIR": str(directory), "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert "Ctrl-C" in process.stdout.readline()
    return process


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    directory = tmp_path_factory.mktemp("lab")
    process = start(directory)
    yield directory
    process.terminate()
    process.wait(10)


def ask(directory: Path, request: bytes) -> dict[str, Any]:
    """One request by a client that knows nothing of us."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as client:
        client.bind("")
        client.settimeout(10)
        client.sendto(request, str(directory / "lab.sock"))
        reply = json.loads(client.recv(1 << 20))
    assert isinstance(reply, dict)
    return reply


def test_requests_are_answered_as_they_come(lab: Path) -> None:
    first = ask(lab, b'{"op": "ping"}')
    assert first["ok"]
    assert not ask(lab, b"nonsense")["ok"]
    assert "longer than" in ask(lab, b" " * 70_000)["error"]
    told = ask(lab, b'{"op": "get"}')
    assert len(told["nodes"]) == 17
    assert told["time"] > first["time"]


def test_a_client_that_wants_or_reads_no_reply_does_no_harm(lab: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as client:
        client.sendto(b'{"op": "get"}', str(lab / "lab.sock"))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as client:
        client.bind("")
        client.setblocking(False)
        for _ in range(200):
            try:
                client.sendto(b'{"op": "kinds"}', str(lab / "lab.sock"))
            except BlockingIOError:
                ask(lab, b'{"op": "ping"}')
    assert ask(lab, b'{"op": "ping"}')["ok"]


def test_only_its_owner_can_reach_it(lab: Path) -> None:
    assert stat.S_IMODE((lab / "lab.sock").stat().st_mode) == 0o600


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can speak as another user")
def test_another_user_who_has_got_in_is_refused(lab: Path) -> None:
    # With the file's own protection out of the way, the kernel's word about the sender is left.
    script = f"""
import os, socket
door = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
door.bind("")
door.settimeout(10)
door.connect({str(lab / "lab.sock")!r})
os.setgid({NOBODY})
os.setuid({NOBODY})
door.send(b'{{"op": "inject", "fault": {{"kind": "unplug", "channel": "can0", "node": 1}}}}')
print(door.recv(65536).decode())
"""
    said = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=30
    )
    reply = json.loads(said.stdout)
    assert reply == {
        "ok": False,
        "error": f"this lab belongs to user {os.geteuid()}; user {NOBODY} is not permitted",
    }
    assert all(node["plugged"] for node in ask(lab, b'{"op": "get"}')["nodes"])


def test_the_door_of_a_lab_that_was_killed_is_no_hindrance(tmp_path: Path) -> None:
    first = start(tmp_path)
    first.kill()
    first.wait(10)
    assert (tmp_path / "lab.sock").exists()
    second = start(tmp_path)
    assert ask(tmp_path, b'{"op": "ping"}')["ok"]
    second.terminate()
    second.wait(10)
    assert not (tmp_path / "lab.sock").exists()


def test_a_cable_pulled_by_command_is_seen_on_the_bus(
    lab: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(lab))

    def command(*arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "tonus.tools.cli", "fault", *arguments],
            capture_output=True,
            text=True,
            check=True,
            timeout=30,
        )
        return done.stdout

    def booted() -> set[int]:
        bus.send(can.Message(arbitration_id=0, is_extended_id=False, data=b"\x82\x00"))
        heard = set()
        for _ in range(100):
            message = bus.recv(0.5)
            if message is None:
                break
            heard.add(message.arbitration_id)
        return heard

    with can.Bus(interface="tonus", channel="can1") as bus:
        assert "done at" in command("unplug", "--channel", "can1", "--node", "3")
        assert booted() == {0x705, 0x713, 0x715}
        assert "unplugged" in command("get")
        command("replug", "--channel", "can1", "--node", "3")
        assert booted() == {0x703, 0x705, 0x713, 0x715}
