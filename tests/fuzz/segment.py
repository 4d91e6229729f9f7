"""The emulated EtherCAT segment under fire: random frames, and those of a bring-up, mutated."""

from __future__ import annotations

import gc
import random
import struct
import sys
from collections import Counter
from collections.abc import Iterator

import numpy as np

from tests.ethercat_bench import MS, OP, STATION, US, SegmentBench
from tonus.sim.ethercat.frames import Command, Datagram, build, physical
from tonus.sim.ethercat.slaves.registers import MEMORY_END
from tonus.sim.ethercat.slaves.states import State

CHECK_EVERY = 1000
GROWTH = 30_000
"""memory blocks that may be held more than after the first checks"""
_SETTLED = 20
"""checks until memory is weighed for the first time"""
_BRING_UP_EVERY = 2000
_REGISTERS = (
    0x000, 0x010, 0x012, 0x100, 0x103, 0x110, 0x120, 0x130, 0x300, 0x400, 0x420, 0x440, 0x500,
    0x502, 0x504, 0x508, 0x600, 0x610, 0x800, 0x805, 0x808, 0x80D, 0x810, 0x818, 0x900, 0x910,
    0x920, 0x928, 0x930, 0x980, 0x981, 0x990, 0x9A0, 0x1000, 0x1030, 0x1060, 0x1080, 0x10F0,
    0x1100, 0x2000, 0x2FFF,
)  # fmt: skip
_LOGICAL = 0x10000


class FallenError(AssertionError):
    """The segment did not stay standing."""


class SegmentUnderFire:
    """Fires and checks; ``reached`` counts the states that were seen."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self.bench = SegmentBench(seed=1)
        self.heard: list[bytes] = []
        self._listen()
        self.reached: Counter[str] = Counter()
        self.answered = 0
        self._checks = 0
        self._blocks = 0

    def _listen(self) -> None:
        """Keep the frames of a bring-up with SYNC0 and of some cycles."""
        exchange = self.bench.segment.exchange

        def keep(frame: bytes, at_ns: int, port: int = 0) -> bytes | None:
            self.heard.append(frame)
            return exchange(frame, at_ns, port)

        self.bench.segment.exchange = keep  # type: ignore[method-assign]
        try:
            self._bring_up()
        finally:
            self.bench.segment.exchange = exchange  # type: ignore[method-assign]

    def _bring_up(self) -> None:
        bench = self.bench
        for place in range(bench.count):
            bench.segment.cable.switch(place, on=False)
            bench.segment.cable.switch(place, on=True)
        bench.wait(5)
        bench.operate(0, 1, 2, sync_ns=MS)
        for word in (0x06, 0x07, 0x0F, 0x0F):
            bench.cycle([(word, 10)] * 3)
            bench.wait(1)

    # -- shots -----------------------------------------------------------------------------------

    def shots(self) -> Iterator[bytes]:
        """Without end: a third at random, a third mutated, a third in the words of a master."""
        draw = self._random
        while True:
            kind = draw.random()
            if kind < 0.02:
                yield draw.randbytes(draw.randrange(0, 100))
            elif kind < 0.35:
                yield build([self._datagram() for _ in range(draw.randrange(1, 5))])
            elif kind < 0.7:
                yield self._mutated(draw.choice(self.heard))
            else:
                yield draw.choice(self.heard)

    def _datagram(self) -> Datagram:
        draw = self._random
        command = draw.choice((*Command, draw.randrange(256)))
        size = draw.choice((0, 1, 2, 4, 6, 8, 16, 48, 128, draw.randrange(400)))
        data = draw.randbytes(size) if draw.random() < 0.7 else bytes(size)
        if command in (Command.LRD, Command.LWR, Command.LRW):
            address = _LOGICAL + draw.randrange(-8, 64)
            if draw.random() < 0.1:
                address = draw.getrandbits(32)
        else:
            place = draw.choice((STATION + draw.randrange(12), -draw.randrange(12), 0))
            offset = draw.choice((*_REGISTERS, draw.randrange(0x10000)))
            address = physical(place, offset)
        return Datagram(command, address, data, draw.randrange(256), draw.randrange(4))

    def _mutated(self, frame: bytes) -> bytes:
        draw = self._random
        data = bytearray(frame)
        for _ in range(draw.randrange(1, 6)):
            data[draw.randrange(14, len(data))] = draw.randrange(256)
        if draw.random() < 0.1:
            del data[draw.randrange(len(data)) :]
        return bytes(data)

    def fire(self, frame: bytes) -> None:
        bench = self.bench
        bench.now += self._random.choice((5, 20, 100, 1000)) * US
        answer = bench.segment.exchange(frame, bench.now)
        self.reached[bench.slaves[0].state.name] += 1
        if answer is not None:
            self.answered += 1
            if len(answer) != len(frame):
                raise FallenError("an answer is not as long as its frame")

    # -- checks ----------------------------------------------------------------------------------

    def check(self) -> None:
        """Everything is finite, within bounds, and a master can begin anew."""
        bench = self.bench
        plant = bench.lab.plant
        for name in ("motor_angle", "motor_rate", "current", "cell_force"):
            if not np.isfinite(getattr(plant, name)).all():
                raise FallenError(f"the plant's {name} is not finite")
        for slave in bench.slaves:
            if len(slave.controller.memory) != MEMORY_END:
                raise FallenError("the memory has another size")
            if slave.controller.word(0x130) != slave.standing.word:
                raise FallenError("the status register does not tell the state")
            if slave.state not in State:
                raise FallenError("there is no such state")
        self._checks += 1
        if self._checks * CHECK_EVERY % _BRING_UP_EVERY == 0:
            self._prove()
        if self._checks % 10 == 0:
            self._weigh()

    def _prove(self) -> None:
        """The segment comes up as if nothing had been."""
        self._bring_up()
        bench = self.bench
        if [bench.standing(place)[0] for place in range(3)] != [OP] * 3:
            raise FallenError("it does not come to OP any more")
        identity = struct.pack("<I", 0x65510000)
        if bench.upload(0, 0x1018, 2) != identity:
            raise FallenError("the mailbox does not work any more")

    def _weigh(self) -> None:
        gc.collect()
        blocks = sys.getallocatedblocks()
        if self._checks == _SETTLED:
            self._blocks = blocks
        elif self._blocks and blocks > self._blocks + GROWTH:
            raise FallenError(f"{blocks - self._blocks} memory blocks more are held")


def fuzz_segment(seed: int, frames: int, tell: int = 0) -> SegmentUnderFire:
    """Raises what the segment raises, or `FallenError`, with the frame in its words."""
    target = SegmentUnderFire(seed)
    for number, frame in enumerate(target.shots(), start=1):
        try:
            target.fire(frame)
            if number % CHECK_EVERY == 0 or number == frames:
                target.check()
        except Exception as error:
            raise FallenError(f"frame {number}, {frame.hex()}: {error!r}") from error
        if tell and number % tell == 0:
            print(f"{number} frames, segment at {target.bench.now / 1e9:.1f} s", flush=True)
        if number == frames:
            return target
    raise AssertionError
