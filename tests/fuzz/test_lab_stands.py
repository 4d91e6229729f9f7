"""The short storm, and that a storm can tell who has fallen."""

from __future__ import annotations

import itertools

import pytest

from tests.fuzz.lab import attack, shortest, targets
from tests.fuzz.shots import Shot, Storm, Targets
from tonus.sim.can.canopen.node import Node
from tonus.sim.can.wire.frame import Frame

pytestmark = pytest.mark.wide


@pytest.fixture(scope="module")
def known() -> Targets:
    return targets()


@pytest.mark.parametrize("seed", range(3))
def test_seventeen_devices_and_the_plant_stand_in_a_storm(known: Targets, seed: int) -> None:
    fell = attack(list(itertools.islice(Storm(seed, known), 8000)))
    assert fell is None, f"seed {seed}: {fell!r}; see python -m tests.fuzz --seed {seed}"


def test_a_storm_is_its_seed(known: Targets) -> None:
    first, again, other = (list(itertools.islice(Storm(n, known), 500)) for n in (7, 7, 8))
    assert first == again != other


def test_no_device_is_told_to_leave(known: Targets) -> None:
    """Else a device that obeys would count as one that fell."""
    for shot in itertools.islice(Storm(3, known), 20_000):
        written = shot.data[:3] if len(shot.data) == 8 and shot.data[0] >> 5 == 1 else b""
        assert written[1:] not in (b"\x00\x20", b"\x01\x20")


def test_what_falls_is_found_and_made_short(
    known: Targets, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A node with a planted flaw: a SYNC with a counter kills it."""
    real = Node._on_sync

    def flawed(self: Node, frame: Frame) -> None:
        if frame.data == b"\x01":
            raise ZeroDivisionError
        real(self, frame)

    monkeypatch.setattr(Node, "_on_sync", flawed)
    killer = Shot(100, "can0", 0x080, b"\x01")
    bring_up = known.bring_up["can0"]
    shots = [*bring_up[:80], killer, *bring_up[80:]]
    fell = attack(shots)
    assert isinstance(fell, ZeroDivisionError)
    short = shortest(shots, type(fell))
    # One synchronous PDO, started: the rest of the bring-up was not needed.
    assert short[-1] == killer
    assert len(short) <= 3
