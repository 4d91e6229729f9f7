"""One lost frame of any kind, at many times in ACTIVE, stops nothing."""

from __future__ import annotations

import errno
from typing import Any

import pytest
from loop import QUICK

from tonus.config.document import dotted
from tonus.config.schema.place import DEFAULTS
from tonus.runtime.states import State
from tonus.sim.devices.tracker import Tracker
from tonus.tools.expect import Run
from tonus.tools.testing.held import HeldFactory
from tonus.tools.testing.player import Player

pytestmark = [pytest.mark.tonus(overrides=QUICK), pytest.mark.tonus_expect("*"), pytest.mark.wide]
FIRST_S, APART_S = 2.6, 0.0687
"""after the drives were enabled: in ACTIVE; apart by no multiple of any period"""
LOSSES = 24
DURATION_S = FIRST_S + LOSSES * APART_S - 2.0
CAN1 = (0x77F, 0x703, 0x713, 0x080, 0x203, 0x205, 0x183, 0x193)
"""heartbeats of master, drive and cell, SYNC, torques, measurements"""


def losses(channel: str, identifiers: tuple[int | None, ...]) -> list[dict[str, Any]]:
    return [
        {
            "kind": "loss",
            "channel": channel,
            "identifier": identifiers[number % len(identifiers)],
            "frames": 1,
            "at": FIRST_S + number * APART_S,
        }
        for number in range(LOSSES)
    ]


def went_on(run: Run) -> None:
    assert (run.state, run.reason, run.summary["faults"]) == ("STANDBY", "scenario completed", [])


def states_at(run: Run, event: str) -> set[int]:
    """In which states an event of this name was told."""
    log = run.log
    ticks, states = log["/tonus/timing"]["tick"], log["/tonus/state"]["state"]
    told = [each.tick for each in run.events if each.name == event]
    return {int(states[ticks.searchsorted(tick)]) for tick in told}


def test_a_lost_heartbeat_of_the_master_stops_no_drive(tonus_held: HeldFactory) -> None:
    """The one at 5.0 s stopped the robot where drives waited for exactly two periods."""
    faults = [
        {"kind": "loss", "channel": "can1", "identifier": 0x77F, "frames": 1, "at": FIRST_S + at}
        for at in (0.0, 0.137, 0.281, 0.403, 0.555, 0.698, 0.839)
    ]
    went_on(tonus_held.play(faults=faults, duration=1.4))


ROBOT: dict[str, Any] = {dotted(key): safe for key, (safe, _) in DEFAULTS.items()}
"""what a robot without a lab has"""
ON_CAN = {key: safe for key, safe in ROBOT.items() if not key.startswith("sto_relay")}
RELAY = (0x77E, 0x278, 0x1F8, 0x778)
"""heartbeat and output of the supervisor, inputs and heartbeat of the relay's node"""


@pytest.mark.parametrize(
    "values", [pytest.param({}, marks=pytest.mark.long), ON_CAN], ids=["lab", "robot"]
)
def test_one_lost_frame_of_each_kind_on_can_stops_nothing(
    tonus_held: HeldFactory, values: dict[str, Any]
) -> None:
    faults = losses("can1", CAN1)
    run = tonus_held.play(faults=faults, duration=DURATION_S, overrides=values)
    went_on(run)
    assert states_at(run, "missing_pdo") == {State.ACTIVE}


def test_one_lost_frame_on_a_segment_stops_nothing(tonus_held: HeldFactory) -> None:
    """With a robot's values, the shorter watchdog among them, and of each kind on the relay's
    channel."""
    run = tonus_held.play(
        config="config/ethercat.yaml",
        faults=[*losses("tonus0", (None,)), *losses("sto", RELAY)],
        duration=DURATION_S,
        overrides=ROBOT,
    )
    went_on(run)
    run.never("sto_relay_open")
    run.never("supervisor_lost")
    assert states_at(run, "frame_lost") == {State.ACTIVE}


def test_a_lost_pose_of_the_tracker_stops_nothing(
    tonus_run: Player, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every tenth datagram, from bring-up on: referencing does without them as well."""
    poll, seen = Tracker.poll, [0]

    def lossy(tracker: Tracker, now_ns: int) -> list[bytes]:
        kept = []
        for datagram in poll(tracker, now_ns):
            seen[0] += 1
            if seen[0] % 10:
                kept.append(datagram)
        return kept

    monkeypatch.setattr(Tracker, "poll", lossy)
    run = tonus_run("hold", config="config/direct.yaml", duration=0.5)
    went_on(run)
    assert seen[0] > 300
    run.never("tracker_lost")


def test_a_tracker_whose_socket_fails_stops_nothing(
    tonus_run: Player, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For 300 ms in ACTIVE; the estimate rests on the cables and then has poses again."""
    poll, polls = Tracker.poll, [0]

    def failing(tracker: Tracker, now_ns: int) -> list[bytes]:
        polls[0] += 1
        if 2600 < polls[0] <= 2900:
            raise OSError(errno.ENETDOWN, "Network is down")
        return poll(tracker, now_ns)

    monkeypatch.setattr(Tracker, "poll", failing)
    run = tonus_run("hold", config="config/direct.yaml", duration=1.0)
    went_on(run)
    assert states_at(run, "tracker_receive_failure") == {State.ACTIVE}
    told = [event.name for event in run.events if event.name.startswith("tracker_")]
    assert told.count("tracker_receive_failure") == 9  # the 1st, 2nd, 4th ... 256th
    assert {"tracker_lost", "tracker_back"} <= set(told)
