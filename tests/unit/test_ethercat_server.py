"""A lab's server with an EtherCAT segment: a frame finds the work before it done."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from tonus.config import load
from tonus.runtime.timing import clock
from tonus.sim.lab import server
from tonus.sim.lab.engine import Lab


class Port:
    """A segment's port on no network."""

    lab: Lab
    looked_ns: list[int]
    """where the lab was whenever frames were asked for"""

    def __init__(self, *_: Any) -> None:
        Port.looked_ns = []

    def receive_all(self) -> None:
        Port.looked_ns.append(Port.lab.now_ns)

    def close(self) -> None:
        """Nothing is open."""


class WakeUp:
    """Remembers, and does not ring."""

    due_ns = 0

    def __init__(self, *_: Any) -> None:
        WakeUp.due_ns = 0

    def at(self, due_ns: int) -> None:
        WakeUp.due_ns = due_ns

    def close(self) -> None:
        """Nothing is open."""


def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lab:
    """A lab that was brought to the present once, and waits."""
    monkeypatch.setattr(server, "SegmentPort", Port)
    monkeypatch.setattr(server, "WakeUp", WakeUp)
    monkeypatch.setattr(server, "open_pair", lambda *_: False)
    config, scenario = load("config/ethercat.yaml", overrides={"sto_relay": None})

    async def serve() -> Lab:
        now = clock.loop_clock()
        lab = Port.lab = Lab(config, scenario.lab, seed=1, clock=now, start_ns=now() - 100_000)
        ready = asyncio.Event()
        serving = asyncio.create_task(server.serve(lab, config, tmp_path, ready.set))
        await ready.wait()
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)
        return lab

    return clock.run(serve(), virtual=False)


def test_the_lab_wakes_for_work_that_a_frame_would_wait_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = served(tmp_path, monkeypatch)
    assert lab.now_ns < WakeUp.due_ns <= lab.next_work_ns()


def test_frames_are_looked_for_before_and_behind_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = served(tmp_path, monkeypatch)
    before, behind = Port.looked_ns
    assert before < behind == lab.now_ns
