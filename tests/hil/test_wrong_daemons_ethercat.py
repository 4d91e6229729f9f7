"""On EtherCAT, with a relay in the circuit of the STO inputs: the supervisor stops all drives of a
daemon that has died or is wrong, and no others. STO-1 to STO-4.

Drives and relay are looked at in the lab in every tick. A time counts from the change of the daemon
to the tick in which the last drive has no power and reports STO; the drives take what their maker
states as the longest (`sto_relay.torque_off_ms`), which no real one has to need.
"""

from __future__ import annotations

from typing import Any

import pytest

from tests.relayed import PATH, RelayRun, relay_of
from tests.supervised import BRIEF, DRIVES, configured
from tests.wrong_daemons import (
    AT_ONCE,
    AXIS,
    LATER,
    Change,
    blind,
    both,
    in_quick_stop,
    opposite,
    torque_on_the_bus,
)
from tonus.config import load
from tonus.config.loader import load_scenario
from tonus.config.schema.faults import Loss, PowerCycle, Unplug
from tonus.config.schema.robot_faults import CableCut
from tonus.config.schema.supervisor import Requirement
from tonus.config.timeouts import node_timeout_ms
from tonus.runtime.states import Fault, Operator, State, StopMode
from tonus.runtime.supervisor.supervisor import Supervisor
from tonus.runtime.timing import clock
from tonus.tools.campaign.again import first_difference
from tonus.tools.campaign.observed import Observed
from tonus.tools.campaign.play import Operated, Playing
from tonus.tools.run.supervision import Overheard

pytestmark = pytest.mark.wide

OUTPUT_MS = 10.0
"""from the change to the output's end, the longest of what is found at once"""
SLOWER = {"torques frozen on the bus": 26.0}
"""a torque that stays is wrong once the one that is recorded has gone away from it"""
FOUND = {
    "torques frozen on the bus": {Requirement.COMMAND_LOGGED},
    "tensions far beyond their bound, no fault found": {Requirement.UNEXPLAINED},
}
"""where the frames are not read, found by what the drives report"""
ROBOT_RELAY = {"timeout_ms": 7}
ROBOT: dict[str, Any] = {f"sto_relay.{key}": value for key, value in ROBOT_RELAY.items()}
"""as without a lab"""
MS = 1_000_000


def _run(patch: pytest.MonkeyPatch, change: Change, **given: Any) -> tuple[RelayRun, Observed]:
    scenario, seconds = given.pop("scenario", "sine_z"), given.pop("seconds", 0.3)
    config, _ = configured(PATH, **ROBOT, **given.pop("overrides", {}))
    run = RelayRun(config, load_scenario(scenario), lambda: change(patch), **given)
    with patch.context():
        seen = run.play(seconds)
    patch.undo()
    return run, seen


def _all_stopped(run: RelayRun, seen: Observed, output_ms: float) -> None:
    """Output, contacts and drives, each after its time; a tick is how often they are looked at."""
    relay = relay_of(run.config)
    assert sorted(run.stopped_ns) == list(DRIVES), seen.error
    assert run.off_ms <= output_ms
    assert run.open_ms <= run.off_ms + relay.release_ms + 1.0
    assert run.slowest_ms <= run.open_ms + relay.torque_off_ms + 1.0


@pytest.mark.parametrize("name", AT_ONCE)
def test_a_wrong_daemon_on_ethercat_loses_the_torque_of_every_drive(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    change, requirements = AT_ONCE[name]
    run, seen = _run(monkeypatch, change, overrides=BRIEF)
    _all_stopped(run, seen, SLOWER.get(name, OUTPUT_MS))
    assert {number for number, _ in run.said} == FOUND.get(name, requirements)


@pytest.mark.parametrize(
    ("name", "output_ms"),
    list(zip(LATER, (OUTPUT_MS, 24.0, 60.0, 66.0, 30.0), strict=True)),
    ids=list(LATER),
)
def test_a_mistake_on_ethercat_that_has_to_show(
    name: str, output_ms: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, seen = _run(monkeypatch, LATER[name].change, overrides=BRIEF)
    _all_stopped(run, seen, output_ms)
    found = FOUND.get(name, {LATER[name].requirement})
    assert {number for number, _ in run.said} == found
    assert State.SAFE_STOP not in seen.state, "the daemon stops nothing"


@pytest.mark.parametrize("axes", [(5,), (0, 4), tuple(range(8))], ids=str)
def test_drives_on_ethercat_that_hold_their_motors_by_themselves(
    axes: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Commanded to quick stop on the bus alone. At a standstill they had not been found in 2 s."""
    change = both(blind, in_quick_stop(*axes))
    run, seen = _run(monkeypatch, change, overrides=BRIEF, scenario="hold")
    _all_stopped(run, seen, 30.0)
    assert {number for number, _ in run.said} == {Requirement.DISARMED}


def test_a_torque_beyond_the_limit_of_a_drive_in_a_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    """On the bus alone, while the drive reports that it is at a limit of its own. It had not been
    found in 0.3 s, 267 N."""

    def beyond(torques: Any) -> Any:
        torques[AXIS] = 3500 * run.config.robot.signs[AXIS]
        return torques

    config, _ = configured(PATH, **ROBOT, **BRIEF)
    change = both(blind, torque_on_the_bus(beyond))
    run = RelayRun(
        config, load_scenario("hold"), lambda: change(monkeypatch), State.SAFE_STOP, at=0.1
    )
    with monkeypatch.context():
        seen = run.play(0.2)
    monkeypatch.undo()
    _all_stopped(run, seen, OUTPUT_MS)
    assert {number for number, _ in run.said} == {Requirement.COMMAND_LOGGED}
    assert seen.truth["tension"][seen.truth_ns > run.changed_ns].max() <= 100.0


def test_a_contact_on_ethercat_that_the_daemon_ignores(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the instant at which it is truly beyond the supervisor's bound."""
    pushed = {**BRIEF, "control.envelope.enabled": False}
    run, seen = _run(
        monkeypatch, blind, scenario="contact_near", overrides=pushed, seconds=6.0, at=0.1
    )
    assert {number for number, _ in run.said} == {Requirement.CONTACT}
    run.changed_ns = int(seen.truth_ns[seen.truth["contact_force"] > 27.5][0])
    _all_stopped(run, seen, OUTPUT_MS)


def test_a_daemon_in_order_on_ethercat_is_let_be(monkeypatch: pytest.MonkeyPatch) -> None:
    run, seen = _run(monkeypatch, lambda _: None, overrides=BRIEF, seconds=1.0)
    assert not run.said
    assert not run.stopped_ns
    names = {each.name for each in seen.events}
    assert not names & {"unsupervised", "supervisor_lost", "supervisor_stopped", "sto_relay_open"}
    assert run.released[0], "open until the supervisor holds it"
    assert not run.released[-1]


@pytest.mark.parametrize("order", [Operator.STOP, Operator.ESTOP])
def test_a_robot_with_brakes_on_ethercat_is_let_be(
    order: Operator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its drives hold their motors by themselves until the brakes are open."""
    told = Operated.next

    def ordered(script: Operated, sequence: Any) -> Operator:
        return order if run.changed_ns else told(script, sequence)

    monkeypatch.setattr(Operated, "next", ordered)
    brake = {"torque": 0.4, "opening_ms": 40.0, "closing_ms": 20.0}
    stated = {"supervisor.policy": "require", "robot.brake": brake, "supervisor.disarmed_ms": 50}
    config, _ = configured(PATH, **ROBOT, **BRIEF, **stated)
    run = RelayRun(config, load_scenario("hold"), at=0.2)
    seen = run.play(0.6)
    assert run.changed_ns, "it is armed"
    assert State.ACTIVE not in seen.state[-100:], "it obeys"
    assert not run.said


def test_a_stop_of_the_daemons_own_on_ethercat_is_let_be(monkeypatch: pytest.MonkeyPatch) -> None:
    def cut() -> None:
        assert run._playing.lab is not None
        run._playing.lab.inject(CableCut(axis=2))

    config, _ = configured(PATH, **ROBOT, **BRIEF)
    run = RelayRun(config, load_scenario("sine_z"), cut)
    seen = run.play(3.0)
    assert State.SAFE_STOP in seen.state
    assert not run.said
    assert not run.off_ns
    assert "sto_relay_open" not in {each.name for each in seen.events}


def test_what_it_stopped_for_is_in_the_log_on_ethercat(monkeypatch: pytest.MonkeyPatch) -> None:
    _, seen = _run(monkeypatch, torque_on_the_bus(opposite), overrides=BRIEF)
    found = {(each.name, each.where): each.text for each in seen.events}
    assert "SUP-10 at 2" in found["supervisor_stopped", "sto"]
    assert ("supervisor_lost", "sto") in found
    assert ("sto_relay_open", "sto/120") in found
    reported = [each for each in seen.events if each.name == "drive_error"]
    assert len(reported) == len(DRIVES)
    assert all("0x8A88" in each.text for each in reported)


@pytest.mark.parametrize("fault", [Unplug, PowerCycle])
def test_a_relay_that_is_cut_off_opens(fault: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its node hears nobody any more, or has lost what it was told."""

    def away() -> None:
        relay, lab = relay_of(run.config), run._playing.lab
        assert lab is not None
        lab.inject(fault(channel=relay.channel, node=relay.node_id))

    config, _ = configured(PATH, **ROBOT, **BRIEF)
    run = RelayRun(config, load_scenario("sine_z"), away)
    seen = run.play(0.5)
    _all_stopped(run, seen, relay_of(config).timeout_ms + 1.0)
    assert not run.said, "the daemon is in order"


def _losing(frames: int, seconds: float) -> tuple[RelayRun, Observed]:
    """A run in which heartbeats of the relay's node are lost: all that shows of one that hangs."""

    def lost() -> None:
        relay, lab = relay_of(run.config), run._playing.lab
        assert lab is not None
        identifier = 0x700 + relay.node_id
        lab.inject(Loss(channel=relay.channel, identifier=identifier, frames=frames))

    config, _ = configured(PATH, **ROBOT, **BRIEF)
    run = RelayRun(config, load_scenario("sine_z"), lost)
    return run, run.play(seconds)


def test_a_relay_that_hangs_while_the_drives_are_enabled() -> None:
    """The supervisor could not stop them any more: the daemon does, along the path, and with their
    torque. The record tells why, and commands the same again."""
    run, seen = _losing(10_000, 5.0)
    config, state = run.config, seen.cycle["state"]
    relay = relay_of(config)
    assert not run.said
    assert run.off_ns > seen.cycle_ns[seen.state == State.SAFE_STOP][-1], "its output stays on"
    stopped = seen.cycle_ns[seen.state == State.SAFE_STOP]
    waited_ms = (stopped[0] - run.changed_ns) * 1e-6
    limit_ms = node_timeout_ms(relay, relay.master, config.tolerance)
    assert limit_ms - relay.heartbeat_ms <= waited_ms <= limit_ms + 2.0
    assert set(state["fault"][seen.cycle_ns >= stopped[0]]) == {Fault.RELAY_SILENT}
    assert set(state["stop_mode"][seen.state == State.SAFE_STOP]) == {StopMode.ON_PATH}
    assert len(stopped) > 1000, "it is lowered"
    assert seen.state[-1] == State.FAULT
    assert {"heartbeat_lost", "relay_silent"} <= {each.name for each in seen.events}
    assert first_difference(seen) is None


def test_a_lost_heartbeat_of_the_relay_stops_nothing() -> None:
    run, seen = _losing(1, 0.5)
    assert State.SAFE_STOP not in seen.state
    assert not run.off_ns
    assert "heartbeat_lost" not in {each.name for each in seen.events}


@pytest.mark.parametrize("policy", ["require", "use"])
def test_without_it_a_robot_with_a_relay_is_not_armed(
    policy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No drive could be enabled, whatever the policy."""
    monkeypatch.setattr(Supervisor, "step", lambda *_: None)
    config, _ = configured(PATH, **{"supervisor.policy": policy})
    end = Playing(config, load_scenario("hold"), 1, tail=0.1, longest=5.0).run().end
    assert end is not None
    assert "sto relay: is open: the supervisor does not hold it" in end.reason
    assert ("supervisor of sto: is not heard on sto" in end.reason) == (policy == "require")


@pytest.mark.parametrize("policy", ["require", "use"])
@pytest.mark.parametrize("path", [PATH, "config/mixed.yaml"])
def test_an_output_that_stays_on_without_the_supervisor(
    path: str, policy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a short circuit, or welded contacts: its node says that it is off. Under `require` the
    supervisor, which has stopped for a pause of the record, sends single heartbeats."""
    relay = load(PATH)[0].sto_relay
    assert relay is not None
    own = {"sto_relay": relay.model_dump(mode="json") | ROBOT_RELAY, "supervisor.policy": policy}
    publish = Overheard.publish

    def paused(overheard: Overheard, *given: Any) -> None:
        if not run.changed_ns or clock.now_ns() >= run.changed_ns + 12 * MS:
            publish(overheard, *given)

    def short_circuit() -> None:
        run.node()._switched = lambda _: None

    monkeypatch.setattr(Overheard, "publish", paused)
    config, _ = configured(path, **BRIEF, **own)
    run = RelayRun(config, load_scenario("hold"), short_circuit, at=0.1)
    seen = run.play(0.4)
    assert {number for number, _ in run.said} == {Requirement.TICK}
    assert run.off_ns, "as it says"
    assert not run.stopped_ns
    stopped = seen.cycle["state"][seen.state == State.SAFE_STOP]
    assert set(stopped["fault"]) == {Fault.SUPERVISOR_IGNORED}
    assert set(stopped["stop_mode"]) == {StopMode.ON_PATH}
    found_ms = (seen.cycle_ns[seen.state == State.SAFE_STOP][0] - run.changed_ns) / MS
    assert found_ms <= 100.0


def test_cells_on_can_beside_a_relay() -> None:
    """The supervisor beats on the relay's channel alone, and nothing waits for it elsewhere."""
    relay = load(PATH)[0].sto_relay
    assert relay is not None
    own = relay.model_dump(mode="json") | {"timeout_ms": 7}
    stated = {"sto_relay": own, "supervisor.policy": "require"}
    config, _ = configured("config/mixed.yaml", **BRIEF, **stated)
    run = RelayRun(config, load_scenario("hold"), state=State.ACTIVE, at=0.1)
    seen = run.play(0.1)
    assert run.changed_ns, "it is armed"
    assert seen.state[-1] == State.ACTIVE
    assert not run.off_ns
