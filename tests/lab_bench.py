"""A lab in virtual time with a bus user's few words for it."""

from __future__ import annotations

import struct
from functools import cache
from types import TracebackType
from typing import Any, Self

import can

from tonus.config import load
from tonus.config.schema.lab import LabScript
from tonus.config.schema.root import Config
from tonus.sim.lab.engine import Lab

MS = 1_000_000


@cache
def _config(name: str) -> Config:
    return load(name)[0]


class Bench:
    """``now`` is the time; nothing happens on its own."""

    def __init__(
        self,
        name: str = "config/can.yaml",
        script: LabScript | None = None,
        seed: int = 1,
        **over: Any,
    ) -> None:
        overrides = over.get("overrides")
        self.config: Config = load(name, overrides=overrides)[0] if overrides else _config(name)
        self.now = 0
        self.lab = Lab(
            self.config,
            script or LabScript(),
            seed=seed,
            clock=self.clock,
            truth=over.get("truth"),
            nodes=over.get("nodes"),
        )
        self.lab.open()
        self.buses: dict[str, can.BusABC] = {
            name: can.Bus(interface="tonus", channel=name) for name in self.lab.channels
        }

    def clock(self) -> int:
        return self.now

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        for bus in self.buses.values():
            bus.shutdown()
        self.lab.close()

    def send(self, channel: str, identifier: int, data: bytes = b"") -> None:
        self.buses[channel].send(
            can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
        )

    def read(self, channel: str) -> list[can.Message]:
        found = []
        while (message := self.buses[channel].recv(timeout=0)) is not None:
            found.append(message)
        return found

    def wait(self, ms: float) -> None:
        self.now += round(ms * MS)
        self.lab.advance(self.now)

    def request(self, channel: str, node: int, data: bytes) -> bytes:
        """One SDO request's answer."""
        self.read(channel)
        self.send(channel, 0x600 + node, data)
        self.wait(2)
        answers = [m for m in self.read(channel) if m.arbitration_id == 0x580 + node]
        assert len(answers) == 1, f"{len(answers)} answers"
        return bytes(answers[0].data)

    def write(self, channel: str, node: int, index: int, sub: int, value: int, size: int) -> int:
        """Abort code of an expedited download, 0 if it was accepted."""
        command = 0x23 | (4 - size) << 2
        word = (value & (1 << 8 * size) - 1).to_bytes(4, "little")
        answer = self.request(channel, node, struct.pack("<BHB", command, index, sub) + word)
        if answer[0] == 0x80:
            return int.from_bytes(answer[4:], "little")
        assert answer[:4] == struct.pack("<BHB", 0x60, index, sub)
        return 0

    def upload(self, channel: str, node: int, index: int, sub: int) -> bytes:
        """An expedited upload's data, or the abort code's bytes."""
        answer = self.request(channel, node, struct.pack("<BHB4x", 0x40, index, sub))
        if answer[0] == 0x80:
            return answer[4:]
        return answer[4 : 8 - (answer[0] >> 2 & 3)]

    def configure(self, channel: str, node: int, cell: bool = False) -> None:
        """One SYNC-driven RPDO and TPDO, as a robot's master wants them."""
        steps = [(0x1800, 1, 0xC0000180 + node, 4), (0x1800, 2, 1, 1)]
        if not cell:
            steps += [
                (0x3001, 2, 16000, 4),
                (0x3001, 5, 71000, 4),
                (0x6060, 0, 10, 1),
                (0x1A00, 0, 0, 1),
                (0x1A00, 1, 0x60410010, 4),
                (0x1A00, 2, 0x60640020, 4),
                (0x1A00, 3, 0x60770010, 4),
                (0x1A00, 0, 3, 1),
                *((0x1400 + n, 1, 0x80000200 + 0x100 * n + node, 4) for n in range(4)),
                (0x1600, 0, 0, 1),
                (0x1600, 1, 0x60400010, 4),
                (0x1600, 2, 0x60710010, 4),
                (0x1600, 0, 2, 1),
                (0x1400, 2, 1, 1),
                (0x1400, 1, 0x200 + node, 4),
            ]
        steps.append((0x1800, 1, 0x40000180 + node, 4))
        for index, sub, value, size in steps:
            code = self.write(channel, node, index, sub, value, size)
            assert code == 0, f"0x{index:04X}:{sub} refused with 0x{code:08X}"

    def configure_all(self) -> None:
        for spec in self.config.fieldbus.channels:
            for drive in spec.drives:
                self.configure(spec.name, drive.node_id)
            for cell in spec.force_cells:
                self.configure(spec.name, cell.node_id, cell=True)
            self.send(spec.name, 0x000, b"\x01\x00")
        self.wait(2)
        for name in self.buses:
            self.read(name)

    def tick(self, word: int, torque: int = 0, beat: bool = True) -> None:
        """One millisecond of SYNC and set-points on every channel."""
        for spec in self.config.fieldbus.channels:
            self.send(spec.name, 0x080)
            for drive in spec.drives:
                self.send(spec.name, 0x200 + drive.node_id, struct.pack("<Hh", word, torque))
            if beat:
                self.send(spec.name, 0x77F, b"\x05")
        self.wait(1)

    def enable(self) -> None:
        for word in (0x00, 0x06, 0x0F):
            for _ in range(3):
                self.tick(word)
        assert all(drive.enabled for drive in self.lab.drives)
