"""The pair of interfaces: made, refused in one line, never taken from somebody else."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tonus.sim.errors import LabError
from tonus.sim.ethercat import veth

TYPED = [
    "ip link add near type veth peer name far",
    "ip link set near arp off addrgenmode none up",
    "ip link set far arp off addrgenmode none up",
]
"""man ip-link: neither address resolution nor IPv6 puts a frame of its own on it"""


@pytest.fixture
def host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of interfaces, and an ip command that does as it is told."""
    monkeypatch.setattr(veth, "_INTERFACES", tmp_path)
    monkeypatch.setattr(veth.shutil, "which", lambda name: f"/sbin/{name}")
    return tmp_path


def ip(monkeypatch: pytest.MonkeyPatch, code: int, words: str = "") -> list[str]:
    called: list[str] = []

    def run(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        called.append(" ".join(command))
        return subprocess.CompletedProcess(command, code, "", words)

    monkeypatch.setattr(veth.subprocess, "run", run)
    return called


def test_a_pair_is_made_quiet_and_up(host: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    called = ip(monkeypatch, 0)
    assert veth.open_pair("near", "far")
    assert called == TYPED


def test_interfaces_that_are_there_are_used_and_left(
    host: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    called = ip(monkeypatch, 0)
    (host / "far").mkdir()
    assert not veth.open_pair("near", "far")
    assert called == []


def test_what_is_not_allowed_is_said_with_what_to_type(
    host: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ip(monkeypatch, 2, "RTNETLINK answers: Operation not permitted\n")
    with pytest.raises(LabError) as refused:
        veth.open_pair("near", "far")
    words = str(refused.value)
    assert "\n" not in words
    assert "Operation not permitted" in words
    assert " && ".join(TYPED) in words


def test_a_host_without_the_command_is_told_so(host: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(veth.shutil, "which", lambda name: None)
    with pytest.raises(LabError, match="no ip command"):
        veth.open_pair("near", "far")


def test_half_a_pair_is_none(host: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    called = ip(monkeypatch, 0)
    (host / "near").mkdir()
    with pytest.raises(LabError, match="no pair"):
        veth.open_pair("near", "far")
    assert called == []
