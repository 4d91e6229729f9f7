"""Logs of every schema version so far still open: a few ticks round each change of state, and what
they are known to hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tonus.runtime.signals import SCHEMA_VERSION
from tonus.runtime.states import State
from tonus.tools.cli.log.info import describe
from tonus.tools.errors import ToolError
from tonus.tools.log import open as open_log
from tonus.tools.log.replay import replay

GOLDEN = Path(__file__).parent / "golden"


def test_there_is_one_of_each_version() -> None:
    assert {path.stem for path in GOLDEN.glob("*.mcap")} == {
        f"v{number}" for number in range(1, SCHEMA_VERSION + 1)
    }


@pytest.mark.parametrize("path", sorted(GOLDEN.glob("*.mcap")), ids=lambda path: path.stem)
def test_it_opens_whole_and_tells_its_states(path: Path) -> None:
    told = describe(open_log(path))
    assert told["damage"] is None
    assert told["metadata"]["schema_version"] == path.stem[1:]
    assert [row["state"] for row in told["states"]] == [
        *("OFF", "STANDBY", "REFERENCING", "PRETENSION", "HOLD", "ACTIVE", "SAFE_STOP", "STANDBY")
    ]


def test_the_first_holds_the_numbers_it_held() -> None:
    log = open_log(GOLDEN / "v1.mcap")
    timing, tension = log["/tonus/timing"], log["/tonus/tension"]
    assert timing["tick"][[0, 40, -1]].tolist() == [0, 2413, 4617]
    assert tension["measured"][40].round(4).tolist() == [
        *(50.341, 50.4274, 50.305, 50.4038, 40.1754, 40.2666, 40.144, 40.209)
    ]
    assert (log["/tonus/state"]["state"][41:50] == State.ACTIVE).all()
    assert np.unique(log["/tonus/stiffness"]["k_eq"][-5:]).tolist() == [3210.0]
    assert log.events()[0].text == "OFF to STANDBY"


def test_a_replay_of_an_old_log_ends_in_a_result_or_in_one_line() -> None:
    """Its configuration may lack what is needed today."""
    log = open_log(GOLDEN / "v1.mcap")
    try:
        assert replay(log, last=7).ticks == 8
    except ToolError as told:
        refused = str(told)
        assert_one_line(refused)


def assert_one_line(text: str) -> None:
    assert "v1.mcap" in text
    assert "\n" not in text
