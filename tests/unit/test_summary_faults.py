"""What the summary of a log says of faults."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from tonus.runtime.states import Fault, State
from tonus.tools.run.summary import find_faults


def test_of_several_faults_in_one_tick_the_first_is_named() -> None:
    """As the daemon names it: it is the reason for the stop."""
    state = np.zeros(3, [("fault", "u1"), ("fault_where", "i2"), ("state", "u1")])
    state["state"] = State.HOLD
    state[1:] = (Fault.DRIVE_LOST, 0, State.SAFE_STOP)
    timing = np.array([(10,), (11,), (12,)], [("tick", "u4")])
    places = ["can0/1 (axis 0)", "can3/8 (axis 7)"]
    topics = {"/tonus/state": state, "/tonus/timing": timing}

    class Told(dict[str, Any]):
        def events(self) -> list[Any]:
            return [SimpleNamespace(tick=11, name="drive_lost", where=place) for place in places]

    (found,) = find_faults(Told(topics))  # type: ignore[arg-type]
    assert found == {
        "tick": 11,
        "name": "drive_lost",
        "where": "can0/1 (axis 0)",
        "reaction": "SAFE_STOP",
    }
