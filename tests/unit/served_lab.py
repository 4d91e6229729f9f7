"""A lab that serves its sockets, and their user, on one loop in real time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import can
import pytest

from tonus.config import load
from tonus.sim.lab.engine import Lab
from tonus.sim.lab.server import serve


def message(identifier: int, data: bytes = b"", **over: Any) -> can.Message:
    return can.Message(arbitration_id=identifier, data=data, **{"is_extended_id": False, **over})


def drain(bus: can.BusABC) -> list[can.Message]:
    return list(iter(lambda: bus.recv(timeout=0), None))


def served(
    directory: Path, monkeypatch: pytest.MonkeyPatch, use: Callable[[Lab], Awaitable[None]]
) -> None:
    """A lab and its user on one loop, in real time for as long as ``use`` takes."""
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(directory))
    config, scenario = load("config/can.yaml", overrides={"tracker.port": 49_777})

    async def main() -> None:
        loop = asyncio.get_running_loop()

        def clock() -> int:
            return int(loop.time() * 1e9)

        lab = Lab(config, scenario.lab, seed=1, clock=clock, start_ns=clock())
        ready = asyncio.Event()
        serving = loop.create_task(serve(lab, config, directory, ready.set))
        await ready.wait()
        try:
            await asyncio.wait_for(use(lab), 20)
        finally:
            serving.cancel()

    asyncio.run(main())


async def until(found: Callable[[], bool]) -> None:
    while not found():
        await asyncio.sleep(0.002)
