"""The tracker's address: its form is checked with the configuration, its host before a run."""

from __future__ import annotations

import socket
import sys
from typing import Any

import pytest

from tonus.config import ConfigError, load
from tonus.tools.cli.main import main

LONG = ".".join(["a" * 60] * 5)


@pytest.mark.parametrize(
    "address", ["127.0.0.1", "localhost", "tracker.lab-2.local", "host_1", "a.b."]
)
def test_an_address_or_a_host_name_is_taken(address: str) -> None:
    config, _ = load("config/can.yaml", overrides={"tracker.address": address})
    assert config.tracker.address == address


@pytest.mark.parametrize(
    "address",
    ["nowhere host", "999.1.1.1", "1.2.3", "", "::1", "-a", "a-", "a..b", "host:5", LONG, "a\n"],
)
def test_anything_else_is_refused_with_what_to_write(address: str) -> None:
    with pytest.raises(
        ConfigError, match=r"neither an IPv4 address nor a host name; write"
    ) as told:
        load("config/can.yaml", overrides={"tracker.address": address})
    assert told.value.key == "tracker.address"
    assert len(str(told.value)) < 250


@pytest.mark.parametrize("command", ["run", "lab"])
def test_a_name_that_the_host_does_not_know_starts_nothing(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def unknown(*_: Any) -> Any:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    typed = ["tonus", command, "config/can.yaml", "--set", "tracker.address=nowhere"]
    monkeypatch.setattr(sys, "argv", typed)
    with pytest.raises(SystemExit) as ending:
        main()
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert ending.value.code == 2
    assert "tracker.address: this host knows no IPv4 address of 'nowhere'" in line
    assert "--set tracker.address=ADDRESS" in line
