"""The control socket as an operator, a flooding client and a second daemon meet it."""

from __future__ import annotations

import asyncio
import json
import math
import os
import re
import socket
import stat
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from operated import Client, Operated, told

from tonus.config.schema.operation import ControlSocket as Settings
from tonus.drivers.process_image import AxisState, ProcessImage
from tonus.runtime.operation import control_socket
from tonus.runtime.operation.control_door import STATUS
from tonus.runtime.operation.control_socket import ControlSocket, ControlSocketError, Peers
from tonus.runtime.operation.operator import Script
from tonus.runtime.operation.verbs import VERBS
from tonus.runtime.signals import Grade
from tonus.runtime.states import Event, Fault, Operator, State

SETTINGS = Settings()


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Operated]:
    operated = Operated(tmp_path)
    yield operated
    operated.close()


def test_a_session_as_an_operator_has_it(robot: Operated) -> None:
    assert robot.command("arm")["next"] == "wait until it is in STANDBY"
    robot.until(State.STANDBY)
    robot.advance(10)
    reply = robot.command("arm")
    assert reply["ok"]
    assert reply["text"].startswith("STANDBY to REFERENCING")
    robot.until(State.HOLD)
    for verb, state in (("start", "ACTIVE"), ("hold", "HOLD"), ("start", "ACTIVE")):
        assert robot.command(verb)["state"] == state
    assert robot.command("stop")["state"] == "SAFE_STOP"
    robot.until(State.STANDBY)
    assert robot.command("estop")["state"] == "FAULT"
    reply = robot.command("reset")
    assert (reply["ok"], reply["text"]) == (True, "devices are being brought back")
    robot.until(State.STANDBY)


def test_every_command_and_refusal_is_an_event_that_names_who_and_why(robot: Operated) -> None:
    robot.bring_to(State.HOLD)
    robot.command("arm")
    robot.command("estop")
    robot.command("reset")
    robot.advance(20)
    robot.command("scenario", name="sine_y")
    robot.command("scenario", name="nope")
    me = rf"by \S+ \(uid {os.geteuid()}, pid {os.getpid()}\)"
    commands = told(robot.events, "operator")
    assert [text.split(" by ")[0] for text in commands] == [
        *("arm", "estop", "reset", "scenario sine_y")
    ]
    refused = told(robot.events, "refused")
    assert len(refused) == 2
    assert "arm is not allowed in HOLD" in refused[0]
    assert all(re.search(me, text) for text in commands + refused)


def test_the_status_has_the_fields_that_are_documented(robot: Operated) -> None:
    kinds: dict[str, Any] = {
        "string": str,
        "boolean": bool,
        "number": (int, float),
        "integer": int,
        "string or null": (str, type(None)),
        "array of string": list,
        "array of number": list,
        "array of object": list,
    }
    for state in (State.STANDBY, State.HOLD):
        robot.bring_to(state)
        reply = robot.command("status")
        assert reply.pop("ok") is True
        assert reply.pop("op") == "status"
        assert set(reply) == set(STATUS)
        for name, value in reply.items():
            assert isinstance(value, kinds[STATUS[name][0]]), name
        assert reply["state"] == state.name
        assert reply["grade"] in Grade.__members__
    assert told(robot.events, "operator") == [told(robot.events, "operator")[0]], "a look is none"


def test_a_status_is_there_while_the_bus_is_brought_up(tmp_path: Path) -> None:
    robot = Operated(tmp_path, bring_up_s=1.0)
    reply = robot.command("status", 100)
    assert (reply["state"], reply["tick"]) == ("OFF", None)
    assert "brought up" in robot.command("arm", 100)["error"]
    robot.close()


def test_an_emergency_stop_ends_a_bring_up(tmp_path: Path) -> None:
    robot = Operated(tmp_path, bring_up_s=1000.0)
    robot.advance(50)
    robot.client.ask(op="estop")
    robot.advance(50)
    (reply,) = robot.client.replies()
    assert (reply["ok"], reply["state"]) == (True, "FAULT")
    outcome = robot.outcome
    assert outcome is not None
    assert (outcome.state, outcome.fault) == (State.FAULT, Fault.EMERGENCY_STOP)
    assert "emergency stop" in outcome.reason
    assert (outcome.ticks, robot.bus.stopped) == (0, True)
    assert told(robot.events, "emergency_stop")
    assert told(robot.events, "operator")[0].startswith("estop by ")
    robot.close()


@pytest.mark.parametrize("script", [None, Script(10.0)])
def test_a_signal_ends_a_bring_up(tmp_path: Path, script: Script | None) -> None:
    robot = Operated(tmp_path, bring_up_s=1000.0, script=script)
    robot.advance(50)
    robot.console.stop("signal SIGINT")
    robot.advance(50)
    outcome = robot.outcome
    assert outcome is not None
    assert (outcome.state, outcome.fault) == (State.OFF, Fault.NONE)
    assert outcome.reason == "stopped by the operator while the bus was brought up"
    assert (outcome.ticks, robot.bus.stopped) == (0, True)
    robot.close()


def test_who_cancels_the_run_itself_cancels_a_bring_up(tmp_path: Path) -> None:
    robot = Operated(tmp_path, bring_up_s=1000.0)
    robot.advance(50)
    assert robot._running is not None
    robot._running.cancel()
    with pytest.raises(asyncio.CancelledError):
        robot.advance(50)
    assert robot.bus.stopped
    robot.close()


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (b"nonsense", "not JSON"),
        (b"[1]", "is a JSON object"),
        (b"\xff", "not UTF-8"),
        (b"{}", "op is missing"),
        (b'{"op": "dance"}', "there is no op 'dance'"),
        (b'{"op": ["arm"]}', "there is no op"),
        (b'{"op": "arm", "now": 1}', "'now' is not a field of arm"),
        (b'{"op": "scenario"}', "name is missing"),
        (b'{"op": "scenario", "name": {}}', "there is no scenario {}"),
        (b"[" * 600, "not JSON"),
        (b"x" * 5000, "longer than 1024 bytes"),
    ],
)
def test_whatever_is_sent_is_answered_in_one_line(
    robot: Operated, message: bytes, words: str
) -> None:
    robot.client.send(message + b"\n")
    robot.advance(10)
    (reply,) = robot.client.replies()
    assert reply["ok"] is False
    assert words in reply["error"]
    assert reply["next"]
    assert "\n" not in reply["error"]
    assert not any(moment.operator for moment in robot.history)


def test_one_message_a_tick_however_many_come(robot: Operated) -> None:
    robot.until(State.STANDBY)
    robot.client.send(b'{"op": "status"}\n' * 15)
    robot.advance(2)
    for _ in range(10):
        robot.client.replies()
        robot.advance(1)
        assert len(robot.client.replies()) <= 1
    robot.advance(20)
    robot.client.replies()
    assert robot.command("arm")["ok"]


def test_a_flood_is_slowed_down_and_holds_up_nobody_else(tmp_path: Path) -> None:
    robot = Operated(tmp_path, overrides={"operation.socket.rate_hz": 20.0})
    robot.until(State.STANDBY)
    flood = Client(robot.path)
    flood.send(b'{"op": "status"}\n' * 2000)
    robot.advance(500)
    replies = flood.replies()
    answered = sum(reply["ok"] for reply in replies)
    refused = [reply["error"] for reply in replies if not reply["ok"]]
    burst, backlog = robot.config.operation.socket.burst, robot.config.operation.socket.backlog
    assert burst <= answered <= burst + 20 * 0.6
    assert refused == [f"{2000 - backlog} messages more than {backlog} that may wait were not kept"]
    assert robot.command("estop")["ok"], "another client is heard within a few ticks"
    flood.close()
    robot.close()


STATUS_LINE, STOP_LINE = b'{"op": "status"}\n', b'{"op": "estop"}\n'
SLOW = {"operation.socket.rate_hz": 0.1, "operation.socket.burst": 1}


def stopped_in_the_next_tick(robot: Operated) -> bool:
    """The tick under way hears it, the next one obeys."""
    robot.advance(1)
    handled = len(robot.history)
    robot.advance(1)
    return robot.history[handled].state is State.FAULT and not robot.history[handled].enabled


@pytest.mark.parametrize("before", [1, 100, 2000, 9000])
def test_an_emergency_stop_waits_behind_no_message_of_its_own_client(
    tmp_path: Path, before: int
) -> None:
    robot = Operated(tmp_path, overrides=SLOW)
    robot.until(State.STANDBY)
    robot.advance(30)
    robot.client.ask(op="status")
    robot.advance(2)
    assert len(robot.client.replies()) == 1, "and its last token is spent"
    robot.client.send(STATUS_LINE * before + STOP_LINE)
    assert stopped_in_the_next_tick(robot)
    robot.advance(5)
    replies = [reply for reply in robot.client.replies() if reply.get("op") == "estop"]
    assert [reply["ok"] for reply in replies] == [True]
    robot.close()


def test_emergency_stops_wait_behind_no_other_client(tmp_path: Path) -> None:
    robot = Operated(tmp_path, overrides=SLOW)
    robot.until(State.STANDBY)
    clients = [Client(robot.path) for _ in range(robot.config.operation.socket.clients - 1)]
    robot.advance(10)
    for client in clients:
        client.send(STATUS_LINE * 300)
    clients[-1].send(STOP_LINE)
    assert stopped_in_the_next_tick(robot)
    robot.advance(5)
    assert any(reply.get("op") == "estop" for reply in clients[-1].replies())
    for client in clients:
        client.close()
    robot.close()


def test_an_emergency_stop_comes_through_however_many_connect_at_once(tmp_path: Path) -> None:
    robot = Operated(tmp_path)
    robot.until(State.STANDBY)
    clients = [Client(robot.path) for _ in range(robot.config.operation.socket.clients)]
    clients[-1].send(STATUS_LINE * 3000 + STOP_LINE)
    assert stopped_in_the_next_tick(robot)
    for client in clients:
        client.close()
    robot.close()


def test_an_emergency_stop_does_not_wait_for_the_reply_to_a_command(robot: Operated) -> None:
    robot.bring_to(State.HOLD)
    other = Client(robot.path)
    robot.advance(5)
    robot.client.ask(op="start")
    other.ask(op="estop")
    assert stopped_in_the_next_tick(robot)
    robot.advance(5)
    assert other.replies()[0]["ok"]
    assert len(robot.client.replies()) == 1
    other.close()


def test_several_emergency_stops_are_each_answered(robot: Operated) -> None:
    robot.until(State.STANDBY)
    other = Client(robot.path)
    robot.advance(5)
    for client in (robot.client, other):
        client.send(STOP_LINE * 2)
    robot.advance(3)
    for client in (robot.client, other):
        assert [reply["ok"] for reply in client.replies()] == [True, True]
    other.close()


def test_what_was_sent_before_an_emergency_stop_does_not_act_after_it(robot: Operated) -> None:
    robot.bring_to(State.HOLD)
    other = Client(robot.path)
    robot.advance(5)
    other.send(STATUS_LINE * 10 + b'{"op": "reset"}\n' + STATUS_LINE + b'{"op": "arm"}\n')
    robot.client.send(b'{"op": "reset"}\n' + STOP_LINE)
    robot.advance(60)
    assert robot.state is State.FAULT
    late = [reply for reply in other.replies() if "error" in reply]
    assert [reply["op"] for reply in late] == ["reset", "arm"]
    assert all("an emergency stop came after it" in reply["error"] for reply in late)
    assert len(robot.client.replies()) == 2
    assert robot.command("reset")["ok"], "a new one does"
    other.close()


def test_more_mentions_than_can_be_read_are_an_emergency_stop(robot: Operated) -> None:
    robot.until(State.STANDBY)
    robot.client.send(b'{"op": "arm", "x": "estop"}\n' * 10)
    robot.advance(20)
    assert robot.state is State.STANDBY
    robot.client.send(b'{"op": "arm", "x": "estop"}\n' * 100)
    assert stopped_in_the_next_tick(robot)


def test_one_who_says_stop_and_hangs_up_is_heard(robot: Operated) -> None:
    robot.until(State.STANDBY)
    robot.client.send(STATUS_LINE + STOP_LINE)
    robot.client.close()
    assert stopped_in_the_next_tick(robot)
    robot.advance(20)
    assert not robot.socket._clients


def test_an_emergency_stop_is_heard_while_the_rest_of_the_socket_fails(robot: Operated) -> None:
    robot.bring_to(State.HOLD)
    robot.failing = True
    door = robot.socket._door
    assert door is not None

    def raising() -> None:
        raise LookupError

    door.watch = raising  # type: ignore[method-assign]
    robot.advance(10)
    assert told(robot.events, "part_off")
    robot.client.ask(op="estop")
    assert stopped_in_the_next_tick(robot)


def test_who_does_not_read_or_says_nothing_makes_room(tmp_path: Path) -> None:
    robot = Operated(tmp_path)
    silent = []
    for _ in range(2 * robot.config.operation.socket.clients):
        silent.append(Client(robot.path))
        robot.advance(2)
    robot.client = Client(robot.path)
    assert robot.command("estop")["ok"]
    for client in silent:
        client.close()
    robot.advance(50)
    robot.close()


def test_half_a_message_harms_nobody(robot: Operated) -> None:
    robot.until(State.STANDBY)
    robot.client.send(b'{"op": "sta')
    robot.advance(5)
    other = Client(robot.path)
    other.ask(op="status")
    robot.advance(5)
    assert other.replies()[0]["ok"]
    robot.client.send(b'tus"}\n')
    robot.advance(5)
    assert robot.client.replies()[0]["ok"]
    other.close()


def test_a_second_daemon_is_refused_and_a_killed_ones_socket_taken_over(tmp_path: Path) -> None:
    path = tmp_path / "tonus.sock"
    first = ControlSocket(path, SETTINGS)
    with pytest.raises(ControlSocketError, match=rf"process {os.getpid()}, has it; end that one"):
        ControlSocket(path, SETTINGS)
    assert path.is_socket(), "and the first one's is left alone"
    first.close()
    with socket.socket(socket.AF_UNIX) as left_behind:
        left_behind.bind(str(path))
    ControlSocket(path, SETTINGS).close()


def test_the_file_has_the_mode_it_is_given(tmp_path: Path) -> None:
    for mode in (0o600, 0o660):
        opened = ControlSocket(tmp_path / "s", Settings(mode=f"0{mode:o}"))
        assert stat.S_IMODE((tmp_path / "s").stat().st_mode) == mode
        opened.close()


@pytest.mark.parametrize("settings", [{"users": ("nobody-there",)}, {"groups": ("nor-here",)}])
def test_a_user_that_there_is_not_is_named(settings: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(ControlSocketError, match=r"there is no .* 'no"):
        ControlSocket(tmp_path / "s", Settings(**settings))


def peer(uid: int, gid: int, groups: tuple[int, ...] = ()) -> Any:
    """A connection of which the kernel says this."""

    def getsockopt(level: int, option: int, size: int) -> bytes:
        if option == socket.SO_PEERCRED:
            return control_socket._CREDENTIALS.pack(7, uid, gid)
        return b"".join(group.to_bytes(4, "little") for group in groups)

    return SimpleNamespace(getsockopt=getsockopt)


def test_only_those_who_are_named_are_heard() -> None:
    peers = Peers(Settings(users=("1234",), groups=("5678",)))
    assert peers.heard(peer(0, 0)) == (True, "root (uid 0, pid 7)")
    assert peers.heard(peer(1234, 1))[0]
    assert peers.heard(peer(1, 5678))[0]
    assert peers.heard(peer(1, 1, (4, 5678)))[0]
    assert not peers.heard(peer(1235, 1, (4,)))[0]


def test_a_stranger_is_told_so_and_let_go(robot: Operated, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Peers, "heard", lambda self, connection: (False, "uid 7, pid 8"))
    stranger = Client(robot.path)
    stranger.ask(op="estop")
    robot.advance(10)
    (reply,) = stranger.replies()
    assert "uid 7, pid 8 may not" in reply["error"]
    assert stranger.closed
    assert robot.state is not State.FAULT
    stranger.close()


# -- arming needs a self-test ----------------------------------------------------------------------


def spoilt(table: str, field: str, row: int, value: float) -> Any:
    def spoil(image: ProcessImage) -> None:
        getattr(image, table)[field][row] = value

    return spoil


def blind(image: ProcessImage) -> None:
    image.tracker["delay"] = 0.5


def displaced(image: ProcessImage) -> None:
    image.tracker["position"] = (0.0, 0.0, 0.0)


def askew(image: ProcessImage) -> None:
    image.tracker["quaternion"] = (math.cos(0.02), 0.0, math.sin(0.02), 0.0)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (spoilt("axes", "state", 3, AxisState.QUICK_STOP_ACTIVE), "can2/4 (axis 3) is in QUICK"),
        (spoilt("axes", "age", 5, 9), "(axis 5) does not answer"),
        (spoilt("cells", "age", 8, 9), "(contact cell) does not answer"),
        (spoilt("cells", "force", 2, 30.0), "(cell 2) reads"),
        (blind, "its last pose is 0.5 s old"),
        (displaced, "100 mm from its cradle; put it there"),
        (askew, "sees the platform askew, turned by 2.3 deg; put it into the cups of its cradle"),
    ],
)
def test_arming_names_what_the_self_test_found(robot: Operated, spoil: Any, words: str) -> None:
    robot.until(State.STANDBY)
    robot.bus.spoils = [spoil]
    robot.advance(8)
    reply = robot.command("arm")
    assert not reply["ok"]
    assert words in reply["error"]
    assert robot.state is State.STANDBY
    failed = [each for each in robot.command("status")["self_test"] if not each["ok"]]
    assert len(failed) == 1
    assert words in failed[0]["text"]
    robot.bus.spoils = []
    # A heavy filter lets go of a large force slowly.
    robot.advance(200)
    assert robot.command("arm")["ok"]


def test_a_self_test_grows_old(robot: Operated) -> None:
    robot.until(State.STANDBY)
    robot.advance(3)
    test, tick = robot.daemon.self_test, robot.history[-1].tick
    assert not test.obstacles(tick)
    assert "ticks old" in test.obstacles(tick + 20)[0]
    test.forget()
    assert "has not run" in test.obstacles(tick)[0]


def test_a_script_waits_for_the_self_test_and_then_gives_up(tmp_path: Path) -> None:
    for seconds, ends in ((0.05, State.ACTIVE), (0.5, State.STANDBY)):
        robot = Operated(tmp_path, script=Script(10.0, patience_s=0.2))
        robot.bus.spoils = [blind]
        robot.advance(round(1000 * seconds))
        robot.bus.spoils = []
        robot.advance(200)
        assert robot.state is ends
        if ends is State.STANDBY:
            assert robot.outcome is not None
            assert "last pose is 0.5 s old" in robot.outcome.reason
            assert robot.outcome.obstacle
            assert len(told(robot.events, "refused")) == 1, "said once"
        robot.close()


def test_a_script_shares_only_the_ways_to_stop(tmp_path: Path) -> None:
    robot = Operated(tmp_path, script=Script(10.0))
    robot.until(State.ACTIVE)
    assert "a script runs" in robot.command("hold")["error"]
    assert "a script runs" in robot.command("scenario", name="sine_x")["error"]
    assert robot.command("stop")["ok"]
    robot.advance(300)
    assert robot.outcome is not None
    assert robot.outcome.reason == "stopped by the operator"
    robot.close()


# -- scenarios -------------------------------------------------------------------------------------


def test_a_scenario_is_chosen_at_rest_only(robot: Operated) -> None:
    robot.bring_to(State.HOLD)
    assert robot.command("scenario", name="sine_x")["ok"]
    assert robot.command("start")["ok"]
    assert "not while in ACTIVE" in robot.command("scenario", name="hold")["error"]
    robot.advance(100)
    assert robot.command("hold")["ok"]
    assert "slowing down" in robot.command("scenario", name="hold")["error"]
    robot.advance(150)
    assert robot.command("scenario", name="hold")["ok"]
    assert robot.command("status")["scenario"] == "hold"


def test_a_scenario_that_was_played_ends_in_hold_and_begins_anew(tmp_path: Path) -> None:
    robot = Operated(tmp_path)
    robot.catalogue = ()
    object.__setattr__(robot.socket._door._catalogue[0], "duration", 0.3)  # type: ignore[union-attr]
    robot.bring_to(State.HOLD)
    assert robot.command("start")["ok"]
    robot.until(State.HOLD)
    assert any("hold by the end of the scenario" in text for text in told(robot.events, "operator"))
    robot.advance(150)
    assert robot.command("start")["ok"]
    assert robot.command("status")["scenario_s"] < 0.1
    robot.close()


# -- signals ---------------------------------------------------------------------------------------


def test_asked_to_end_it_stops_first_and_takes_no_more_commands(robot: Operated) -> None:
    robot.bring_to(State.ACTIVE)
    robot.console.stop("signal SIGTERM")
    robot.advance(2)
    assert robot.state is State.SAFE_STOP
    assert "about to end" in robot.command("start")["error"]
    robot.advance(300)
    assert robot.outcome is not None
    assert robot.outcome.state is State.STANDBY
    assert "stop by signal SIGTERM" in told(robot.events, "operator")


def test_asked_twice_it_disables_at_once(robot: Operated) -> None:
    robot.bring_to(State.ACTIVE)
    robot.console.stop("signal SIGTERM")
    robot.console.stop("signal SIGTERM")
    robot.advance(3)
    assert robot.history[-1].state is State.FAULT
    assert robot.history[-1].fault is Fault.EMERGENCY_STOP


@pytest.mark.parametrize("state", State)
def test_an_emergency_stop_is_a_fault_in_the_next_tick_from_every_state(
    tmp_path: Path, state: State
) -> None:
    robot = Operated(tmp_path, overrides={"control.sequence.tare_s": 0.02})
    robot.advance(5)
    if state is not State.OFF:
        robot.bring_to(state)
    # A new connection costs nothing: it is let in and heard in one look.
    robot.client.close()
    robot.client = Client(robot.path)
    robot.client.ask(op="estop")
    robot.advance(1)
    handled = len(robot.history)
    robot.advance(1)
    assert robot.history[handled].state is State.FAULT
    assert not robot.history[handled].enabled
    (reply,) = robot.client.replies()
    assert reply["ok"]
    robot.close()


def test_every_operator_command_has_a_verb() -> None:
    spoken = {verb.operator for verb in VERBS.values()} - {Operator.NONE}
    assert spoken == set(Operator) - {Operator.NONE}
    assert all(Event(operator).name.lower() in VERBS for operator in spoken)


def test_a_reply_is_json_in_one_line(robot: Operated) -> None:
    robot.until(State.STANDBY)
    robot.client.ask(op="status")
    robot.advance(3)
    assert json.dumps(robot.client.replies()[0])
