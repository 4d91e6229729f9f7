"""A log of the present schema version, kept as a file: a few ticks round each change of state, and
what it is known to hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from replay.altered import altered

from tonus.runtime.signals import SCHEMA_VERSION
from tonus.runtime.states import State
from tonus.tools.cli.log.info import describe
from tonus.tools.errors import ToolError
from tonus.tools.log import open as open_log
from tonus.tools.log.replay import replay

LOG = Path(__file__).parent / "golden" / f"v{SCHEMA_VERSION}.mcap"
NAMELESS = "x" * 10


def test_it_opens_whole_and_tells_its_states() -> None:
    told = describe(open_log(LOG))
    assert told["damage"] is None
    assert told["metadata"]["schema_version"] == str(SCHEMA_VERSION)
    assert [row["state"] for row in told["states"]] == [
        *("OFF", "STANDBY", "REFERENCING", "PRETENSION", "HOLD", "ACTIVE", "SAFE_STOP", "STANDBY")
    ]


def test_it_holds_the_numbers_it_held() -> None:
    log = open_log(LOG)
    timing, tension = log["/tonus/timing"], log["/tonus/tension"]
    assert timing["tick"][[0, 40, -1]].tolist() == [0, 2413, 4617]
    assert tension["measured"][40].round(4).tolist() == [
        *(50.041, 50.1374, 50.015, 50.0838, 40.0154, 40.0766, 39.974, 40.009)
    ]
    assert (log["/tonus/state"]["state"][41:50] == State.ACTIVE).all()
    assert np.unique(log["/tonus/stiffness"]["k_eq"][-5:]).round(6).tolist() == [429.3]
    assert log.events()[0].text == "OFF to STANDBY"


def test_it_replays_to_the_last_bit() -> None:
    """Up to the first tick that is left out of it."""
    result = replay(open_log(LOG), last=7)
    assert result.ticks == 8
    assert not result.differing


@pytest.mark.parametrize(("topic", "field"), [("drives", "sampled_ns"), ("state", "select")])
def test_a_log_of_another_schema_is_refused_in_one_line(
    topic: str, field: str, tmp_path: Path
) -> None:
    other = altered(
        LOG, tmp_path / "other.mcap", renamed=(f" {field} ", f" {NAMELESS[: len(field)]} ")
    )
    with pytest.raises(ToolError, match=rf"other\.mcap: no /tonus/{topic}\.{field}") as refused:
        replay(open_log(other), last=7)
    assert "\n" not in str(refused.value)
