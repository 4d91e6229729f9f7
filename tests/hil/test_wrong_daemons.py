"""The supervisor stops a robot whose daemon has died or is wrong, and no other: SUP-1 to SUP-14,
SUP-25 and SUP-26.

Each daemon is changed in mid-run, in virtual time and on CAN. What counts is the last drive that
reports the end of the supervisor's heartbeat, as a bus of the test's own receives it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.supervised import BRIEF, DRIVES, REPORT_MS, Run, configured
from tests.wrong_daemons import (
    AT_ONCE,
    CONTRADICTED,
    LATER,
    Change,
    Tightened,
    after,
    anew,
    blind,
    both,
    instead,
    opposite,
    raises,
    torque_in_control,
    torque_on_the_bus,
    without,
    without_power,
)
from tonus.config.loader import load_scenario
from tonus.config.schema.faults import CellBreak, Disconnect, Loss
from tonus.config.schema.supervisor import Requirement
from tonus.drivers.canopen.channels import Channels
from tonus.runtime.control.allocation import Allocation
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.safety.fallback import Fallback
from tonus.runtime.states import State
from tonus.runtime.supervisor.supervisor import Supervisor
from tonus.runtime.timing import clock
from tonus.tools.campaign.observed import Observed
from tonus.tools.campaign.play import Playing

pytestmark = pytest.mark.wide

WITHIN_MS, LOOK_MS = 25.0, 2.0
ALSO = ("nothing is recorded", "torques frozen in control")
"""played by `make test-long`: another makes the same requirement act"""


def _run(monkeypatch: pytest.MonkeyPatch, change: Change, **given: Any) -> tuple[Run, Observed]:
    scenario, seconds = given.pop("scenario", "sine_z"), given.pop("seconds", 0.3)
    config, _ = configured(**given.pop("overrides", {}))
    run = Run(config, load_scenario(scenario), lambda: change(monkeypatch), **given)
    with monkeypatch.context():
        seen = run.play(seconds)
    monkeypatch.undo()
    return run, seen


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.long if name in ALSO else ()) for name in AT_ONCE],
)
def test_a_wrong_daemon_is_stopped_within_25_ms(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    change, requirements = AT_ONCE[name]
    run, seen = _run(monkeypatch, change, overrides=BRIEF)
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert run.slowest_ms - REPORT_MS <= WITHIN_MS
    assert {number for number, _ in run.said} == requirements


@pytest.mark.parametrize("at", [0.500, 0.501])
def test_looks_in_every_second_tick_find_frozen_torques_in_time(
    at: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Just before a look, and just behind one."""
    change, _ = AT_ONCE["torques frozen in control"]
    run, seen = _run(monkeypatch, change, overrides=BRIEF, at=at)
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert run.slowest_ms - REPORT_MS <= WITHIN_MS


def _fastest(run: Run, seen: Observed) -> float:
    """m/s of the platform, after the change."""
    changed = seen.truth_ns > run.changed_ns
    return float(np.linalg.norm(seen.truth["velocity"][changed], axis=1).max())


@pytest.mark.parametrize("name", [*LATER, *CONTRADICTED])
def test_a_daemon_whose_mistake_has_to_show(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    later = (LATER | CONTRADICTED)[name]
    run, seen = _run(monkeypatch, later.change, overrides=BRIEF)
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert run.slowest_ms - REPORT_MS <= later.longest_ms
    assert {number for number, _ in run.said} == {later.requirement}
    assert State.SAFE_STOP not in seen.state, "the daemon stops nothing"
    assert _fastest(run, seen) <= later.speed
    assert seen.truth["tension"][seen.truth_ns > run.changed_ns].max() <= later.tension


def test_references_that_rise_beyond_their_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the record on in which one is beyond the supervisor's bound; the tensions follow."""
    rising = both(blind, anew(lambda: after(Allocation, "distribute", Tightened())))
    run, seen = _run(monkeypatch, rising, overrides=BRIEF, seconds=1.2)
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert {number for number, _ in run.said} == {Requirement.OPPOSED}
    beyond = seen.cycle_ns[(seen.cycle["tension"]["reference"] > 220.0).any(axis=1)][0]
    assert (max(run.stopped_ns.values()) - beyond) * 1e-6 <= WITHIN_MS
    assert seen.truth["tension"].max() <= 235.0


def test_torques_on_which_no_drive_acts(monkeypatch: pytest.MonkeyPatch) -> None:
    """No SYNC, also none on which the zeros of the daemon's own stop would act."""
    mute = instead(Channels, "sync", lambda *_: None)
    robot = BRIEF | {"control.freshness.stale_stop_ticks": 5}
    run, seen = _run(monkeypatch, mute, overrides=robot)
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert run.slowest_ms <= WITHIN_MS
    assert {number for number, _ in run.said} == {Requirement.TORQUE}


@pytest.mark.parametrize(
    ("torques", "longest_ms"), [(opposite, 40.0), (without(2), 75.0)], ids=["sign", "missing"]
)
def test_a_stop_whose_torques_are_wrong(
    torques: Any, longest_ms: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Along the path, in a daemon that finds no fault."""
    change = both(blind, torque_in_control(torques))
    stop = {"state": State.SAFE_STOP, "at": 0.1, "scenario": "hold"}
    run, seen = _run(monkeypatch, change, overrides=BRIEF, **stop)
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert run.slowest_ms <= longest_ms
    assert {number for number, _ in run.said} == {Requirement.OPPOSED}
    assert _fastest(run, seen) <= 0.8


def test_a_stop_in_which_drives_have_no_power(monkeypatch: pytest.MonkeyPatch) -> None:
    """Along the path, in a daemon that finds no fault."""
    stop = {"state": State.SAFE_STOP, "at": 0.05, "scenario": "hold", "seconds": 0.9}
    run, seen = _run(monkeypatch, both(blind, without_power(3, 7)), overrides=BRIEF, **stop)
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert run.slowest_ms <= 45.0
    assert {number for number, _ in run.said} == {Requirement.DISARMED}
    assert _fastest(run, seen) <= 0.6


def test_a_passive_stop_that_drives_its_drums(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its damping has the wrong sign."""

    config, _ = configured()
    twice = 2.0 * config.control.stop.passive_tension * config.robot.drum_radius

    def inverted(_: None, cycle: ControlCycle, image: Any, *rest: Any) -> None:
        del cycle, rest
        image.commands["torque"] = twice - image.commands["torque"]

    change = both(instead(ControlCycle, "act", raises), after(ControlCycle, "fall_back", inverted))
    run, seen = _run(monkeypatch, change, overrides=BRIEF, seconds=0.4)
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert run.slowest_ms <= 74.0
    assert {number for number, _ in run.said} == {Requirement.BRAKED}
    assert _fastest(run, seen) <= 0.8, "the brake beyond `passive_speed` is inverted too"


def test_torques_that_are_kept_where_control_raises_and_has_no_fallback(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """They hold the platform for a while. From the instant at which a drum's rate has truly changed
    by what the supervisor takes for motion."""
    nothing = instead(Fallback, "step", lambda *_, **__: None)
    change = both(instead(ControlCycle, "act", raises), nothing)
    run, seen = _run(monkeypatch, change, seconds=2.0)
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert {number for number, _ in run.said} == {Requirement.BRAKED}
    later = seen.truth_ns > run.changed_ns
    rate = seen.truth["drum_rate"][later] * seen.config.robot.drum_radius
    settings = seen.config.supervisor
    assert settings is not None
    moved = (abs(rate - rate[0]) > settings.frozen_rate).any(axis=1)
    beyond = seen.truth_ns[later][moved][0]
    assert (max(run.stopped_ns.values()) - beyond) * 1e-6 <= WITHIN_MS
    assert _fastest(run, seen) <= 0.8


def test_a_channel_whose_devices_are_not_received() -> None:
    """It gets no heartbeat, so that its drives stop; the daemon's stop has the others."""
    runs: list[Run] = []

    def deaf() -> None:
        lab = runs[0]._playing.lab
        assert lab is not None
        assert lab.script_start_ns is not None
        soon = (clock.now_ns() - lab.script_start_ns) * 1e-9 + 0.001
        lab.extend_script(
            [
                Loss(channel="can1", identifier=identifier, frames=5000, at=soon)
                for identifier in (0x183, 0x185, 0x193, 0x195)
            ]
        )

    runs.append(Run(configured()[0], load_scenario("sine_z"), deaf))
    seen = runs[0].play(3.0)
    run = runs[0]
    assert sorted(run.stopped_ns) == [3, 5], seen.error
    assert max(run.stopped_ns[node] - run.changed_ns for node in (3, 5)) * 1e-6 <= 42.0
    assert not run.said
    assert _fastest(run, seen) <= 0.8


def test_a_contact_that_the_daemon_ignores(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the instant at which it is truly beyond the supervisor's bound, which may be just after
    the cell was asked for a look."""
    pushed = {**BRIEF, "control.envelope.enabled": False}
    run, seen = _run(
        monkeypatch, blind, scenario="contact_near", overrides=pushed, seconds=6.0, at=0.1
    )
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert {number for number, _ in run.said} == {Requirement.CONTACT}
    beyond = seen.truth_ns[seen.truth["contact_force"] > 27.5][0]
    assert (max(run.stopped_ns.values()) - beyond) * 1e-6 <= WITHIN_MS + LOOK_MS


def test_a_daemon_in_order_is_let_be(monkeypatch: pytest.MonkeyPatch) -> None:
    run, seen = _run(monkeypatch, lambda _: None, overrides=BRIEF, seconds=1.0)
    assert not run.said
    assert not run.stopped_ns
    assert not [each.name for each in seen.events if "supervisor" in each.name]


def test_a_daemon_that_stops_for_a_broken_cell_is_let_be(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its amplifier reports the end of its range, and that it is defective."""

    def breaks() -> None:
        assert run._playing.lab is not None
        run._playing.lab.inject(CellBreak(channel="can1", node=21))

    config, _ = configured(**BRIEF)
    run = Run(config, load_scenario("sine_z"), breaks)
    seen = run.play(1.5)
    assert State.SAFE_STOP in seen.state
    assert not run.said
    assert not run.stopped_ns


def test_a_channel_whose_adapter_is_gone() -> None:
    """The daemon stops with the drives of the other channels."""

    def gone() -> None:
        assert run._playing.lab is not None
        run._playing.lab.inject(Disconnect(channel="can1"))

    run = Run(configured(**BRIEF)[0], load_scenario("sine_z"), gone)
    seen = run.play(1.0)
    assert State.SAFE_STOP in seen.state
    assert not run.said
    assert not set(run.stopped_ns) - {3, 5}


def test_its_requirement_is_in_the_log(monkeypatch: pytest.MonkeyPatch) -> None:
    _, seen = _run(monkeypatch, torque_on_the_bus(opposite), overrides=BRIEF)
    found = {(each.name, each.where): each.text for each in seen.events}
    assert "SUP-10 at 2" in found["supervisor_stopped", "can1"]
    assert ("supervisor_lost", "can1") in found


def test_without_it_the_robot_is_not_armed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Supervisor, "step", lambda *_: None)
    config, _ = configured(**{"supervisor.policy": "require"})
    playing = Playing(config, load_scenario("hold"), 1, tail=0.1, longest=5.0)
    end = playing.run().end
    assert end is not None
    told = "supervisor of can0, can1, can2, can3: is not heard on can0, can1, can2, can3"
    assert told in end.reason
