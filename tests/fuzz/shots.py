"""What is fired: valid traffic, valid traffic mutated and out of order, and plain noise.

A storm is a pure function of its seed and of what it is told about its targets, so that a shot is
named by seed and number.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import can

MASTER = 127
SAVE, LOAD = 0x65766173, 0x64616F6C
ADDRESSES = (0x2000, 0x2001)
"""Node id and bit rate: a device that was told to leave is rightly gone."""
_EDGES = (0, 1, 2, 9, 10, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF)
_WORDS = (0x00, 0x02, 0x06, 0x07, 0x0F, 0x1F, 0x80, 0x8F, 0x10F, 0xFFFF)
_EPISODE = (8, 150)
"""Shots of one kind in a row, while other kinds come in between."""


class Shot(NamedTuple):
    """One frame and how long after the one before it."""

    gap_us: int
    channel: str
    identifier: int
    data: bytes = b""
    remote: bool = False
    extended: bool = False
    length: int | None = None
    """DLC of a remote frame"""

    def message(self) -> can.Message:
        return can.Message(
            arbitration_id=self.identifier,
            is_extended_id=self.extended,
            is_remote_frame=self.remote,
            dlc=self.length if self.remote else len(self.data),
            data=None if self.remote else self.data,
        )

    def __str__(self) -> str:
        flags = "x" * self.extended + "r" * self.remote
        return f"+{self.gap_us} us {self.channel} {self.identifier:X}{flags}#{self.data.hex()}"


@dataclass(frozen=True)
class Targets:
    """What a storm knows: nodes and objects by channel, and a bring-up heard on each."""

    nodes: dict[str, tuple[int, ...]]
    objects: dict[tuple[str, int], Sequence[tuple[int, int]]]
    bring_up: dict[str, Sequence[Shot]]


class Storm:
    """An endless, seeded stream of shots."""

    def __init__(self, seed: int, targets: Targets) -> None:
        self._choose = random.Random(seed)
        self._targets = targets
        self._channels = tuple(targets.nodes)
        self._kinds = (
            (self._replay, 5),
            (self._transfers, 5),
            (self._process_data, 4),
            (self._commands, 1),
            (self._beats, 1),
            (self._noise, 2),
        )

    def __iter__(self) -> Iterator[Shot]:
        choose = self._choose
        makers = [maker for maker, weight in self._kinds for _ in range(weight)]
        running: list[Iterator[Shot]] = []
        while True:
            # Up to three episodes at a time, frame by frame in any order.
            while len(running) < 3:
                running.append(choose.choice(makers)(choose.choice(self._channels)))
            episode = choose.choice(running)
            shot = next(episode, None)
            if shot is None:
                running.remove(episode)
            elif not self._sends_away(shot):
                yield shot

    def _sends_away(self, shot: Shot) -> bool:
        data = shot.data
        return (
            len(data) == 8
            and data[0] >> 5 == 1
            and int.from_bytes(data[1:3], "little") in ADDRESSES
            and not shot.remote
        )

    # -- kinds of shots --------------------------------------------------------------------------

    def _length(self) -> int:
        return self._choose.randint(*_EPISODE)

    def _gap(self) -> int:
        """Mostly a burst, at times a wait in which timeouts run out."""
        draw = self._choose.random()
        if draw < 0.6:
            return 0
        if draw < 0.995:
            return self._choose.randint(1, 1000)
        return self._choose.randint(1000, 150_000)

    def _node(self, channel: str) -> int:
        if self._choose.random() < 0.05:
            return self._choose.randint(0, 127)
        return self._choose.choice(self._targets.nodes[channel])

    def _replay(self, channel: str) -> Iterator[Shot]:
        """A bring-up: as it was, mutated, with losses and doubles, or in another order."""
        choose = self._choose
        spoil = choose.choice((0.0, 0.0, 0.02, 0.2))
        shots = list(self._targets.bring_up[channel])
        if choose.random() < 0.3:
            start = choose.randrange(len(shots))
            shots = shots[start : start + self._length()]
        if choose.random() < 0.2:
            choose.shuffle(shots)
        for shot in shots:
            if choose.random() >= spoil:
                yield shot
                continue
            fate = choose.random()
            if fate < 0.2:
                continue  # lost
            if fate < 0.4:
                yield shot  # and once more
            yield self._mutated(shot)

    def _mutated(self, shot: Shot) -> Shot:
        choose = self._choose
        data = bytearray(shot.data)
        draw = choose.random()
        if draw < 0.4 and data:
            data[choose.randrange(len(data))] ^= 1 << choose.randrange(8)
        elif draw < 0.55:
            data = data[: choose.randint(0, len(data))]
        elif draw < 0.65:
            data += choose.randbytes(8 - len(data))
        elif draw < 0.8:
            return shot._replace(identifier=shot.identifier ^ 1 << choose.randrange(11))
        elif draw < 0.9:
            length = choose.randint(0, 8)
            return shot._replace(remote=True, data=b"", length=length)
        else:
            return shot._replace(
                extended=True, identifier=shot.identifier << choose.choice((0, 18))
            )
        return shot._replace(data=bytes(data))

    def _transfers(self, channel: str) -> Iterator[Shot]:
        """SDO: whole ones, cut short, interleaved between nodes, with wrong toggles and aborts."""
        choose = self._choose
        node = self._node(channel)
        for _ in range(self._length() // 4):
            if choose.random() < 0.3:
                node = self._node(channel)
            for data in self._transfer(self._object(channel, node)):
                if choose.random() < 0.05:
                    break  # cut short
                yield Shot(choose.choice((0, 300, 300, 300)), channel, 0x600 + node, data)

    def _object(self, channel: str, node: int) -> tuple[int, int]:
        choose = self._choose
        known = self._targets.objects.get((channel, node))
        if known is None or choose.random() < 0.05:
            return choose.getrandbits(16), choose.getrandbits(8)
        return choose.choice(known)

    def _value(self) -> int:
        choose = self._choose
        draw = choose.random()
        if draw < 0.6:
            return choose.choice(_EDGES)
        if draw < 0.8:
            # A word for a mapping, an identifier, a heartbeat consumer, the two magic words.
            index, sub = self._object(*choose.choice(list(self._targets.objects)))
            mapping = index << 16 | sub << 8 | choose.choice((8, 16, 32))
            watch = choose.choice((1, 2, 17, MASTER)) << 16 | choose.choice((1, 20, 100))
            return choose.choice(
                (mapping, mapping, 0x80000201, 0x40000181, 0x201, watch, SAVE, LOAD)
            )
        return choose.getrandbits(32)

    def _transfer(self, target: tuple[int, int]) -> Iterator[bytes]:
        choose = self._choose
        head = struct.pack("<HB", *target)
        draw = choose.random()
        if draw < 0.35:
            size = choose.choice((1, 2, 4, 4, 3))
            command = 0x23 | (4 - size) << 2 if choose.random() < 0.95 else 0x22
            yield bytes((command,)) + head + struct.pack("<I", self._value())
        elif draw < 0.5:
            yield b"\x40" + head + bytes(4)
            toggle = 0
            for _ in range(choose.choice((0, 1, 2, 5))):
                yield bytes((0x60 | toggle << 4,)) + bytes(7)
                toggle ^= choose.random() < 0.9
        elif draw < 0.8:
            length = choose.choice((0, 1, 2, 4, 5, 7, 8, 20, 200))
            told = choose.choice((length, length, length, 0, 1 << 31, length + 1))
            yield bytes((0x21 if choose.random() < 0.9 else 0x20,)) + head + struct.pack("<I", told)
            toggle = 0
            while length > 0:
                part = min(length, 7)
                length -= part
                last = length == 0 and choose.random() < 0.95
                yield bytes((toggle << 4 | (7 - part) << 1 | last,)) + choose.randbytes(7)
                toggle ^= choose.random() < 0.98
        elif draw < 0.82:
            index, word = choose.choice(((0x1010, SAVE), (0x1011, LOAD)))
            yield struct.pack("<BHBI", 0x23, index, 1, word)
        elif draw < 0.9:
            # A service out of turn, block transfer, an abort.
            command = choose.choice((0x00, 0x10, 0x60, 0x70, 0x80, 0xA0, 0xA3, 0xC0, 0xC6, 0xE0))
            yield bytes((command,)) + head + choose.randbytes(4)
        else:
            yield choose.randbytes(choose.randint(0, 8))

    def _commands(self, channel: str) -> Iterator[Shot]:
        """NMT: the five commands, others, for one, for all, for nobody, of every length."""
        choose = self._choose
        for _ in range(self._length() // 8):
            command = choose.choice(
                (0x01, 0x01, 0x01, 0x02, 0x80, 0x81, 0x82, choose.getrandbits(8))
            )
            data = bytes((command, choose.choice((0, self._node(channel)))))
            if choose.random() < 0.1:
                data = (data + choose.randbytes(6))[: choose.randint(0, 8)]
            yield Shot(self._gap(), channel, 0x000, data)

    def _process_data(self, channel: str) -> Iterator[Shot]:
        """SYNCs and set-points of every length, some for identifiers that are others' own."""
        choose = self._choose
        node = self._node(channel)
        flood = choose.random() < 0.2
        for _ in range(self._length()):
            gap = 0 if flood else self._gap()
            if choose.random() < 0.4:
                data = choose.choice((b"", b"", b"", b"\x01", choose.randbytes(8)))
                yield Shot(gap, channel, 0x080, data)
                continue
            if choose.random() < 0.3:
                node = self._node(channel)
            base = choose.choice((0x200, 0x200, 0x200, 0x300, 0x400, 0x500, 0x180, 0x280))
            torque = choose.choice((0, 100, -100, 1000, -1000, 32767, -32768))
            data = struct.pack("<Hhi", choose.choice(_WORDS), torque, choose.getrandbits(31))
            length = choose.choice((4, 4, 4, 2, 3, 6, 8, choose.randint(0, 8)))
            yield Shot(gap, channel, base + node, data[:length])

    def _beats(self, channel: str) -> Iterator[Shot]:
        """Heartbeats and emergencies in the name of the master, of devices and of strangers."""
        choose = self._choose
        node = choose.choice((MASTER, self._node(channel)))
        for _ in range(self._length() // 4):
            base = choose.choice((0x700, 0x700, 0x700, 0x080, 0x580))
            yield Shot(choose.randint(0, 60_000), channel, base + node, choose.randbytes(1))

    def _noise(self, channel: str) -> Iterator[Shot]:
        choose = self._choose
        for _ in range(self._length()):
            extended = choose.random() < 0.1
            remote = choose.random() < 0.1
            yield Shot(
                self._gap(),
                channel,
                choose.getrandbits(29 if extended else 11),
                b"" if remote else choose.randbytes(choose.randint(0, 8)),
                remote,
                extended,
                choose.randint(0, 8) if remote else None,
            )
