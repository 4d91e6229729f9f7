"""The emulated lab under fire, in virtual time."""

from __future__ import annotations

import gc
import itertools
import struct
import sys
from collections import Counter
from collections.abc import Sequence
from types import TracebackType
from typing import Self

import can
import numpy as np

from tests.fuzz.shots import LOAD, Shot, Storm, Targets
from tests.lab_bench import Bench
from tonus.sim.can.canopen.node import Nmt
from tonus.sim.devices.cia402.drive import Cia402Drive
from tonus.sim.devices.cia402.states import State

DRIVE, CELL = 0x00020192, 0x00020194
CHECK_EVERY = 1000
"""shots between two checks"""
GROWTH = 20_000
"""memory blocks that may be held more than after the first check"""
_HISTORY, _RESTORE = 0x1003, (0x1011, 1)
_DRAIN_EVERY = 32
_BOOT_MS = 30
_PATTERNS = {int(state) for state in State}


class FallenError(AssertionError):
    """A device or the plant did not stay standing."""


class GrownError(FallenError):
    """It holds more and more memory: no few shots did that."""


def targets() -> Targets:
    """Read off a lab of its own: who is there, and what a bring-up sounds like."""
    with Bench() as bench:
        bench.wait(2)
        nodes: dict[str, tuple[int, ...]] = {}
        objects = {}
        for (channel, node), found in bench.lab.nodes.items():
            nodes[channel] = (*nodes.get(channel, ()), node)
            objects[channel, node] = sorted(found.device.objects.entries)
        heard: dict[str, list[Shot]] = {name: [Shot(0, name, 0x000, b"\x81\x00")] for name in nodes}
        ears = {name: can.Bus(interface="tonus", channel=name) for name in nodes}
        devices = {0x180, 0x280, 0x380, 0x480, 0x580, 0x700}
        last = dict.fromkeys(nodes, bench.now)
        bench.configure_all()
        bench.enable()
        for _ in range(20):
            bench.tick(0x0F, 30)
        for name, ear in ears.items():
            while (message := ear.recv(timeout=0)) is not None:
                number = message.arbitration_id
                if number > 0x7F + 1 and number & 0x780 in devices and number != 0x77F:
                    continue
                at = round(message.timestamp * 1e9)
                gap_us = max(at - last[name], 0) // 1000
                last[name] = at
                heard[name].append(Shot(gap_us, name, number, bytes(message.data)))
            ear.shutdown()
        return Targets(nodes, objects, heard)


class LabUnderFire:
    """``fire`` a shot, ``check`` that all are standing; raises `FallenError`."""

    def __init__(self) -> None:
        self._bench = Bench()
        self._bench.wait(2)
        self._shots = 0
        self._blocks = 0
        self._settings = self._settings_now()
        self.refused = 0
        """frames that found the sender's queue full"""
        self.states: Counter[str] = Counter()
        """what the drives were in, at every hundredth shot: what the storm has reached"""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self._bench.__exit__(kind, error, at)

    @property
    def seconds(self) -> float:
        """Lab time."""
        return self._bench.now * 1e-9

    def fire(self, shot: Shot) -> None:
        bench = self._bench
        if shot.gap_us:
            bench.wait(shot.gap_us * 1e-3)
        try:
            bench.buses[shot.channel].send(shot.message())
        except can.CanOperationError:
            self.refused += 1
            bench.wait(1)
        self._shots += 1
        if self._shots % _DRAIN_EVERY == 0:
            self._drain()
        if self._shots % 100 == 0:
            self._look()

    def _drain(self) -> None:
        for name in self._bench.buses:
            self._bench.read(name)
        self._bench.lab.tracker.poll(self._bench.now)

    def _look(self) -> None:
        """Every state is a defined one, and the plant is finite."""
        for (channel, number), node in self._bench.lab.nodes.items():
            where = f"{channel}/{number}"
            if node.state not in Nmt or node.state is Nmt.INITIALISING:
                raise FallenError(f"{where} is in NMT state {node.state!r}")
        for drive in self._bench.lab.drives:
            if drive.statusword() & 0x6F not in _PATTERNS:
                raise FallenError(f"drive {drive.axis} shows {drive.statusword():04X}")
            self.states[drive.state.name] += 1
        if not np.isfinite(self._bench.lab.plant.truth).all():
            raise FallenError(f"the plant is not finite: {self._bench.lab.plant.truth}")

    def check(self) -> None:
        """Reset all and ask each who it is. Settings that were saved are put back."""
        bench = self._bench
        self._look()
        bench.wait(20)  # what the storm has queued
        for name in bench.buses:
            bench.send(name, 0x000, b"\x81\x00")
        bench.wait(_BOOT_MS)
        for (channel, number), node in bench.lab.nodes.items():
            if _RESTORE in node.device.objects.entries:
                code = bench.write(channel, number, *_RESTORE, LOAD, 4)
                if code:
                    raise FallenError(f"{channel}/{number} keeps what was saved: {code:08X}")
        for name in bench.buses:
            bench.read(name)
            bench.send(name, 0x000, b"\x81\x00")
        bench.wait(_BOOT_MS)
        for name in bench.buses:
            booted = [m.arbitration_id for m in bench.read(name) if bytes(m.data) == b"\0"]
            expected = [0x700 + node for channel, node in bench.lab.nodes if channel == name]
            if sorted(booted) != expected:
                raise FallenError(f"{name}: boot-ups {booted}, expected {expected}")
        for (channel, number), node in bench.lab.nodes.items():
            where = f"{channel}/{number}"
            kind = DRIVE if isinstance(node.device, Cia402Drive) else CELL
            if bench.upload(channel, number, 0x1000, 0) != struct.pack("<I", kind):
                raise FallenError(f"{where} does not say what it is")
            if node.state is not Nmt.PRE_OPERATIONAL:
                raise FallenError(f"{where} is in {node.state!r} after a reset")
        for drive in bench.lab.drives:
            if drive.statusword() & 0x6F != State.SWITCH_ON_DISABLED:
                raise FallenError(f"drive {drive.axis} shows {drive.statusword():04X} after reset")
        now = self._settings_now()
        for place, before in self._settings.items():
            changed = [key for key, value in before.items() if now[place][key] != value]
            if changed:
                index, sub = changed[0]
                raise FallenError(f"{place}: 0x{index:04X}:{sub} is not what it was delivered with")

    def _settings_now(self) -> dict[tuple[str, int], dict[tuple[int, int], object]]:
        """What can be set, of every node."""
        return {
            place: {
                key: entry.value
                for key, entry in node.device.objects.entries.items()
                if entry.access == "rw" and entry.read is None and key[0] != _HISTORY
            }
            for place, node in self._bench.lab.nodes.items()
        }

    def weigh(self) -> None:
        """That no more is held than at the first call; a full collection is not cheap."""
        gc.collect()
        blocks = sys.getallocatedblocks()
        if not self._blocks:
            self._blocks = blocks
        elif blocks - self._blocks > GROWTH:
            raise GrownError(f"{blocks - self._blocks} memory blocks more than at the start")


def attack(shots: Sequence[Shot]) -> Exception | None:
    """A fresh lab under these shots and a check: what it fell over, if it did."""
    try:
        with LabUnderFire() as lab:
            for number, shot in enumerate(shots, start=1):
                lab.fire(shot)
                if number % CHECK_EVERY == 0:
                    lab.check()
            lab.check()
    except Exception as error:  # noqa: BLE001 - whatever it is, it is the finding
        return error
    return None


def shortest(shots: Sequence[Shot], kind: type[Exception], tries: int = 300) -> list[Shot]:
    """Fewer shots that bring down a fresh lab in the same way; all, if they do not.

    Leaves out ever smaller parts as long as the rest still does it (delta debugging).
    """
    left = list(shots)
    if not isinstance(attack(left), kind):
        return left
    part = max(len(left) // 2, 1)
    while tries > 0:
        start = 0
        while start < len(left) and tries > 0:
            rest = left[:start] + left[start + part :]
            tries -= 1
            if rest and isinstance(attack(rest), kind):
                left = rest
            else:
                start += part
        if part == 1:
            break
        part = max(part // 2, 1)
    return left


def storm(seed: int, frames: int) -> list[Shot]:
    """The first so many shots of a seed."""
    return list(itertools.islice(Storm(seed, targets()), frames))
