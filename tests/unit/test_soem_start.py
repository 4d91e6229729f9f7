"""SOEM does not notice frames that it loses while it sets slaves up; our start does."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from tonus.config import load
from tonus.config.schema.bus import EthercatBus
from tonus.drivers.errors import BringUpError
from tonus.drivers.ethercat.soem import SoemMaster

pytest.importorskip("pysoem", reason="pysoem is not installed: the extra ethercat")
PREOP, INIT = 2, 1
AWAY_NS = 300_000_000
INTERFACE = "lo"


class Soem:
    """pysoem's master with three slaves; ``bad`` times its calls leave the last one wrong:
    below PREOP, or ``nameless``."""

    def __init__(self, bad: int, *, nameless: bool = False) -> None:
        self.bad = bad
        self.nameless = nameless
        self.calls = 0
        self.slaves = [self._slave(number) for number in range(3)]
        self.sdo_read_timeout = self.sdo_write_timeout = 0
        self.opened: tuple[str, ...] = ()

    def open(self, *interfaces: str) -> None:
        self.opened = interfaces

    def _slave(self, number: int) -> Any:
        def fprd(register: int, size: int, timeout_us: int) -> bytes:
            del register, timeout_us
            away = AWAY_NS if number == 2 and self._wrong else 0
            return (1_000_000_000 + away).to_bytes(size, "little")

        return SimpleNamespace(
            man=1, id=2, rev=3, name="", state=PREOP, al_status=0, index=number, _fprd=fprd
        )

    @property
    def _wrong(self) -> bool:
        return self.calls <= self.bad

    def config_init(self) -> int:
        self.calls += 1
        last = self.slaves[2]
        last.man = 0 if self._wrong and self.nameless else 1
        below = self._wrong and not self.nameless
        last.state, last.al_status = (INIT, 0x16) if below else (PREOP, 0)
        return len(self.slaves)

    def config_dc(self) -> bool:
        self.calls += 1
        return True

    def state_check(self, state: int, timeout_us: int) -> int:
        del timeout_us
        return state

    def read_state(self) -> int:
        return INIT


class NoPort:
    """A port for frames of our own, on an interface that nothing is sent to."""

    def __init__(self, interface: str) -> None:
        self.interface = interface


def _master(
    bad: int, monkeypatch: pytest.MonkeyPatch, *, nameless: bool = False
) -> tuple[SoemMaster, Soem]:
    """A master whose SOEM and raw socket are replaced, on an interface that every host has."""
    bus = load("config/ethercat.yaml")[0].fieldbus
    assert isinstance(bus, EthercatBus)
    fake = Soem(bad, nameless=nameless)
    monkeypatch.setattr("pysoem.Master", lambda: fake)
    monkeypatch.setattr("tonus.drivers.ethercat.soem.PacketPort", NoPort)
    return SoemMaster(bus.model_copy(update={"interface": INTERFACE}), lambda: 0), fake


def test_a_slave_left_below_preop_is_set_up_again(monkeypatch: pytest.MonkeyPatch) -> None:
    master, fake = _master(2, monkeypatch)
    assert len(asyncio.run(master.scan())) == 3
    assert fake.opened == (INTERFACE,)
    assert fake.calls == 3


def test_one_that_never_comes_is_named_with_its_code(monkeypatch: pytest.MonkeyPatch) -> None:
    master, _ = _master(99, monkeypatch)
    with pytest.raises(BringUpError, match=r"lo/3 stays in INIT, asked for PREOP: .*0x0016"):
        asyncio.run(master.scan())


def test_an_identity_that_was_lost_is_read_again(monkeypatch: pytest.MonkeyPatch) -> None:
    master, _ = _master(2, monkeypatch, nameless=True)
    assert [each.vendor for each in asyncio.run(master.scan())] == [1, 1, 1]
    master, _ = _master(99, monkeypatch, nameless=True)
    with pytest.raises(BringUpError, match=r"lo/3: its identity cannot be read"):
        asyncio.run(master.scan())


async def _aligned(master: SoemMaster, fake: Soem, bad: int) -> int:
    """Scanned without a loss; the clocks then need so many tries more."""
    await master.scan()
    fake.calls, fake.bad = 0, bad
    return await master.align_clocks()


def test_clocks_that_are_apart_are_set_again(monkeypatch: pytest.MonkeyPatch) -> None:
    master, fake = _master(0, monkeypatch)
    assert asyncio.run(_aligned(master, fake, 1)) == 1_000_000_000
    assert fake.calls == 2


def test_a_clock_that_cannot_be_set_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    master, fake = _master(0, monkeypatch)
    with pytest.raises(BringUpError, match=r"lo/3: its clock cannot be set: it is 300 ms"):
        asyncio.run(_aligned(master, fake, 99))
