"""`tonus fault`: the schema's kinds as commands, and their words without a lab."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from lab_bench import Bench

from tonus.config.faults import KINDS
from tonus.config.schema.faults import FAULT
from tonus.sim.lab.door import Door
from tonus.tools.cli.fault import fault
from tonus.tools.errors import ToolError


def call(*arguments: str) -> Result:
    return CliRunner().invoke(fault, arguments)


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[tuple[Bench, str]]:
    """A lab whose door is open on a thread, which is all a client sees of it."""
    path = tmp_path / "lab.sock"
    with Bench() as bench, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        bench.wait(10)
        door = Door(bench.lab)
        listener.bind(str(path))

        def serve() -> None:
            while True:
                request, client = listener.recvfrom(65536)
                if not request:
                    return
                listener.sendto(door.answer(request), client)

        serving = threading.Thread(target=serve)
        serving.start()
        yield bench, str(path)
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as client:
            client.sendto(b"", str(path))
        serving.join()


def test_every_kind_of_the_schema_is_a_command_and_is_listed() -> None:
    assert set(fault.commands) == {"list", "get", *KINDS}
    listed = call("list")
    assert listed.exit_code == 0
    for kind in KINDS.values():
        assert f"\n{kind.name} " in f"\n{listed.output}"
        options = {parameter.name for parameter in fault.commands[kind.name].params}
        assert options == {*(field.name for field in kind.fields), "path"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("unplug --channel can1 --node 3", "unplug channel=can1 node=3: done at 0.010000 s"),
        (
            "drive-error --channel can0 --node 7 --code 0x2310 --at 0.5",
            "drive_error channel=can0 node=7 code=0x2310: will be done at 0.510000 s",
        ),
        (
            "cell_break --channel can0 --node 17 --no-broken",
            "cell_break channel=can0 node=17 broken=False: done at",
        ),
    ],
)
def test_a_command_injects_and_tells_when(
    arguments: str, said: str, lab: tuple[Bench, str]
) -> None:
    result = call(*arguments.split(), "--socket", lab[1])
    assert result.exit_code == 0, result.output
    assert result.output.startswith(said)


def test_what_a_command_sends_is_what_the_schema_takes(
    lab: tuple[Bench, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    sent = []

    def ask(request: dict[str, object], path: Path | None) -> dict[str, object]:
        sent.append(FAULT.validate_python(request["fault"]))
        return {"ok": True, "time": 0.0, "at": 0.0}

    monkeypatch.setattr("tonus.tools.cli.fault.ask", ask)
    values = {"string": "can0", "integer": "1", "number": "1", "vector": "1 1 1"}
    for kind in KINDS.values():
        arguments = []
        for field in kind.fields:
            if field.type == "boolean":
                arguments.append(f"--no-{field.name}")
            else:
                value = field.choices[0] if field.choices else values[field.type]
                arguments += [f"--{field.name.replace('_', '-')}", *value.split()]
        result = call(kind.name, *arguments)
        assert result.exit_code == 0, result.output
        for field in kind.fields:
            assert getattr(sent[-1], field.name) in (
                "can0",
                1,
                False,
                (1, 1, 1),
                *(field.choices or ()),
            )
    assert [each.kind for each in sent] == list(KINDS)


def test_the_table_shows_what_was_done(lab: tuple[Bench, str]) -> None:
    call("unplug", "--channel", "can1", "--node", "3", "--socket", lab[1])
    call("drive_error", "--channel", "can0", "--node", "7", "--code", "0x2310", "--socket", lab[1])
    lines = call("get", "--socket", lab[1]).output.splitlines()
    (unplugged,) = (line for line in lines if "unplugged" in line)
    assert "can1/3" in unplugged
    (failed,) = (line for line in lines if "0x2310" in line)
    assert "can0/7" in failed
    assert "FAULT" in failed
    told = json.loads(call("get", "--json", "--socket", lab[1]).output)
    assert [node["node"] for node in told["nodes"] if not node["plugged"]] == [3]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("unplug --channel can0", "'--node'"),
        ("unplug --channel can0 --node 128", "'128' is not a whole number 1 to 127"),
        ("unplug --channel can0 --node x", "'x' is not a whole number 1 to 127"),
        ("drive_error --channel can0 --node 1 --code 0x10000", "'0x10000' is not"),
        ("drive_input --channel can0 --node 1 --input sta", "'sto'"),
        ("loss --channel can0 --probability 2", "0<=x<=1"),
        ("explode", "No such command 'explode'"),
    ],
)
def test_bad_usage_is_told_without_a_lab(arguments: str, words: str) -> None:
    result = call(*arguments.split())
    assert result.exit_code == 2
    assert words in result.output


def test_without_a_lab_there_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "lab.sock"
    result = call("get", "--socket", str(path))
    assert isinstance(result.exception, ToolError)
    assert str(result.exception) == (
        f"no lab answers at {path} (No such file or directory); start one with: tonus lab CONFIG"
    )


def test_what_the_lab_refuses_is_an_error_in_its_words(lab: tuple[Bench, str]) -> None:
    result = call("unplug", "--channel", "can0", "--node", "99", "--socket", lab[1])
    assert isinstance(result.exception, ToolError)
    assert str(result.exception).startswith(
        "the lab refuses: there is no node 99 on channel 'can0'"
    )
