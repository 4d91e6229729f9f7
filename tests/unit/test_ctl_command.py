"""`tonus ctl` against a daemon in another thread's virtual time: words and exit codes."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.exceptions import Exit
from click.testing import CliRunner, Result
from operated import Operated

from tonus.runtime.states import State
from tonus.tools.cli.ctl import _end, _outcome, ctl
from tonus.tools.errors import ToolError


class Live:
    """Its ticks go on beside the test."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "tonus.sock"
        self._over = threading.Event()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._tick, args=(folder,))
        self._thread.start()
        assert self._ready.wait(30)

    def _tick(self, folder: Path) -> None:
        robot = Operated(folder)
        robot.bring_to(State.STANDBY)
        robot.advance(10)
        self._ready.set()
        while not self._over.is_set():
            robot.advance(5)
        robot.close()

    def close(self) -> None:
        self._over.set()
        self._thread.join()

    def say(self, *words: str) -> Result:
        return CliRunner().invoke(ctl, [*words, "--socket", str(self.path)])


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    live = Live(tmp_path_factory.mktemp("ctl"))
    yield live
    live.close()


def test_a_session_in_words_and_exit_codes(daemon: Live) -> None:
    refused = daemon.say("start")
    assert (refused.exit_code, refused.stdout) == (1, "")
    assert refused.stderr == "refused: start is not allowed in STANDBY; arm it\n"
    armed = daemon.say("arm")
    assert armed.exit_code == 0, armed.stderr
    assert armed.stdout.splitlines()[0].startswith(
        "STANDBY to REFERENCING: the self-test has passed"
    )
    assert armed.stdout.splitlines()[-1].endswith("next: start it, or stop it")
    assert daemon.say("scenario", "sine_x").exit_code == 0
    assert daemon.say("start").exit_code == 0
    assert daemon.say("hold").stdout.startswith("ACTIVE to HOLD: ")
    stopped = daemon.say("stop")
    assert stopped.stdout.splitlines()[-1].startswith("STANDBY: ")
    assert daemon.say("estop").exit_code == 0
    assert daemon.say("arm").exit_code == 1
    assert daemon.say("reset").exit_code == 0


def test_as_json_a_reply_stays_a_reply(daemon: Live) -> None:
    reply = json.loads(daemon.say("hold", "--json").stdout)
    assert (reply["ok"], reply["op"]) == (False, "hold")
    told = daemon.say("status", "--json")
    assert json.loads(told.stdout)["state"] == "STANDBY"
    looks = daemon.say("watch", "--json", "--count", "2", "--rate", "10").stdout.splitlines()
    assert [json.loads(look)["state"] for look in looks] == ["STANDBY", "STANDBY"]


def test_a_status_for_a_person_says_what_to_do(daemon: Live) -> None:
    text = daemon.say("status").stdout
    assert "arm it" in text
    assert "ok: answer and are disabled" in text
    line = daemon.say("watch", "--count", "1").stdout
    assert line.startswith("STANDBY")


def test_without_a_daemon_the_remedy_is_said(tmp_path: Path) -> None:
    result = CliRunner().invoke(ctl, ["arm", "--socket", str(tmp_path / "none.sock")])
    assert isinstance(result.exception, ToolError)
    assert "tonus run CONFIG --serve" in str(result.exception)


def test_what_was_accepted_and_fails_was_not_refused(capsys: pytest.CaptureFixture[str]) -> None:
    told = {"state": "FAULT", "next": "reset it", "fault": "axis 4: a cable is slack"}
    reply = _outcome("arm", told)
    assert (reply["ok"], reply["accepted"]) == (False, True)
    with pytest.raises(Exit) as ended:
        _end(reply, as_json=False)
    assert ended.value.exit_code == 1
    assert capsys.readouterr().err == "failed: axis 4: a cable is slack; reset it\n"
