"""A lab's sockets take whatever a process of its owner writes into them."""

from __future__ import annotations

import random
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from tests.interop import running_lab

pytestmark = pytest.mark.realtime

PACKETS = 400


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    process = running_lab.start(tmp_path)
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(tmp_path))
    yield tmp_path
    assert process.poll() is None, "the lab has ended"
    process.terminate()
    process.wait(10)


def packet(choose: random.Random) -> bytes:
    """Whole frames, halves of frames, nonsense in the flags, the length and the data."""
    draw = choose.random()
    if draw < 0.3:
        return choose.randbytes(choose.randint(1, 4000))
    identifier = choose.getrandbits(choose.choice((11, 29, 32)))
    frame = struct.pack("<QIB3x8s", choose.getrandbits(64), identifier, choose.randint(0, 255), b"")
    return (frame * choose.randint(1, 8))[: choose.randint(1, 192)]


def test_garbage_at_a_channels_socket(lab: Path) -> None:
    choose = random.Random(1)
    for _ in range(4):
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as client:
            client.settimeout(1)
            client.connect(str(lab / "can0.sock"))
            for _ in range(PACKETS // 4):
                try:
                    client.send(packet(choose))
                except (TimeoutError, BrokenPipeError, ConnectionResetError):
                    break  # to hang up on such a client is an answer
    with can.Bus(interface="tonus", channel="can0") as bus:
        bus.send(can.Message(arbitration_id=0, is_extended_id=False, data=b"\x81\x00"))
        booted = set()
        while len(booted) < 4:
            message = bus.recv(3)
            assert message is not None, f"only {booted} answer"
            if bytes(message.data) == b"\0" and message.arbitration_id & 0x780 == 0x700:
                booted.add(message.arbitration_id - 0x700)
        assert booted == {1, 7, 17, 23}
