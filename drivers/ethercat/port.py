"""How frames leave and come back without anybody waiting for them."""

from __future__ import annotations

import ctypes
import os
import socket
import struct
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from tonus.drivers.errors import BringUpError
from tonus.drivers.ethercat.frames import ETHERTYPE, INDEX_AT

FrameExchange = Callable[[bytes, int], bytes | None]
"""(Ethernet frame, time in ns of the loop's clock) to what came back of it, None for nothing."""
FrameCrossing = Callable[[bytes, int, int], tuple[bytes, int] | None]
"""The same through a ring: the end, 0 or 1, it goes in at, and with the answer the one it comes out
at."""

OURS = 0x80
"""Frames of our own carry this index or a higher one; SOEM's stay below 16."""
_FRAME_BYTES = 1518
_BACKLOG = 64
_SO_ATTACH_FILTER = 26
_LOAD_BYTE, _JUMP_IF_AT_LEAST, _RETURN = 0x30, 0x35, 0x06


class FramePort(Protocol):
    """One end of a segment."""

    instant: bool
    """an answer that is not there right after `send` never comes"""
    turned: int | None
    """datagrams of the last answer that the near end of a ring served, while that is open; else
    None"""

    def send(self, frame: bytes, after_ns: int = 0) -> None:
        """``after_ns``: in virtual time, so much later than now."""

    def receive(self) -> bytes | None:
        """The oldest frame that has come back and was not yet taken. Never waits."""

    def close(self) -> None: ...


class InjectedPort:
    """The far end is a function; time is the loop's."""

    instant = True
    turned: int | None = None

    def __init__(self, exchange: FrameExchange, clock: Callable[[], int]) -> None:
        self._exchange = exchange
        self._clock = clock
        self._waiting: deque[bytes] = deque(maxlen=_BACKLOG)

    def send(self, frame: bytes, after_ns: int = 0) -> None:
        answer = self._exchange(frame, self._clock() + after_ns)
        if answer is not None:
            self._waiting.append(answer)

    def receive(self) -> bytes | None:
        return self._waiting.popleft() if self._waiting else None

    def close(self) -> None:
        self._waiting.clear()


class PacketPort:
    """A raw socket of our own beside SOEM's on the same interface. The kernel hands each only its
    own answers, told apart by the index."""

    instant = False
    turned: int | None = None

    def __init__(self, interface: str) -> None:
        """Raises `BringUpError`."""
        try:
            self._socket = socket.socket(
                socket.AF_PACKET, socket.SOCK_RAW | socket.SOCK_NONBLOCK, socket.htons(ETHERTYPE)
            )
            self._socket.bind((interface, ETHERTYPE))
        except OSError as error:
            raise BringUpError(f"{interface}: no raw socket: {error.strerror}") from error
        select(self._socket, ours=True)

    def send(self, frame: bytes, after_ns: int = 0) -> None:
        del after_ns
        try:
            self._socket.send(frame)
        except OSError:
            # A full queue or a cable that is out: as good as a frame that was lost.
            return

    def receive(self) -> bytes | None:
        try:
            return self._socket.recv(_FRAME_BYTES)
        except OSError:
            return None

    def close(self) -> None:
        self._socket.close()


def select(packet_socket: socket.socket, *, ours: bool) -> None:
    """Let a raw socket see only our frames, or all but ours. Linux classic BPF."""
    take, drop = (0xFFFF, 0) if ours else (0, 0xFFFF)
    program = b"".join(
        struct.pack("HBBI", *instruction)
        for instruction in (
            (_LOAD_BYTE, 0, 0, INDEX_AT),
            (_JUMP_IF_AT_LEAST, 0, 1, OURS),
            (_RETURN, 0, 0, take),
            (_RETURN, 0, 0, drop),
        )
    )
    held = ctypes.create_string_buffer(program)
    request = struct.pack("HP", len(program) // 8, ctypes.addressof(held))
    packet_socket.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, request)


def packet_sockets() -> dict[int, str]:
    """Descriptors of this process that are sockets of the packet family, and what they are."""
    found = {}
    for entry in Path("/proc/self/fd").iterdir():
        try:
            target = str(entry.readlink())
            if not target.startswith("socket:"):
                continue
            duplicate = os.dup(int(entry.name))
        except OSError:
            continue  # gone meanwhile
        with socket.socket(fileno=duplicate) as each:
            if each.family == socket.AF_PACKET:
                found[int(entry.name)] = target
    return found
