"""Drives, or a relay, that were shown not to obey the supervisor's silence: after the operator's
reset they do again, or the robot is not armed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.relayed import PATH, RelayRun
from tests.supervised import BRIEF, Run, configured
from tonus.config.loader import load_scenario
from tonus.runtime.safety.sequence import Sequence
from tonus.runtime.states import Fault, Operator, State
from tonus.runtime.timing import clock
from tonus.sim.lab.sto_relay import Relay
from tonus.tools.campaign.observed import Observed
from tonus.tools.campaign.play import Operated
from tonus.tools.run.supervision import Overheard

pytestmark = pytest.mark.wide

MS = 1_000_000
PAUSE_MS = 12
"""of the record, for which the supervisor falls silent"""
LONG_S = 7.0
"""enough for the stop, a reset and an arming"""


Play = Callable[..., Observed]


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> Play:
    """A run in which the record pauses as soon as what is wrong has begun, and an operator resets
    and arms until the robot is controlled again, which ``armed`` is told."""

    def play(run: Run, armed: Callable[[], None] = lambda: None) -> Observed:
        publish, order = Overheard.publish, Operated.next

        def paused(overheard: Overheard, *given: Any) -> None:
            if not run.changed_ns or clock.now_ns() >= run.changed_ns + PAUSE_MS * MS:
                publish(overheard, *given)

        def insisting(script: Operated, sequence: Sequence) -> Operator:
            if not run.changed_ns:
                return order(script, sequence)
            if sequence.state is State.REFERENCING:
                armed()
            if round(sequence.elapsed * 1000) % 200 != 100:
                return Operator.NONE
            orders = {State.FAULT: Operator.RESET, State.STANDBY: Operator.ARM}
            return orders.get(sequence.state, Operator.NONE)

        monkeypatch.setattr(Overheard, "publish", paused)
        monkeypatch.setattr(Operated, "next", insisting)
        monkeypatch.setattr(Operated, "finished", property(lambda _: False))
        return run.play(LONG_S)

    return play


def armed_again(seen: Observed) -> bool:
    stopped = np.flatnonzero(seen.state == State.FAULT)
    assert stopped.size, "it is stopped, and no drive has power any more"
    return bool((seen.state[stopped[0] :] == State.REFERENCING).any())


def events(seen: Observed, name: str) -> list[str]:
    return [each.text for each in seen.events if each.name == name]


@pytest.mark.parametrize("axes", [range(8), [2]])
def test_drives_that_do_not_wait_for_the_supervisor(axes: list[int], played: Play) -> None:
    """Their second consumer is gone without a frame on the bus. They are brought up anew, which
    writes it again; until 2026-11-28 the robot was armed without."""

    def drives() -> list[Any]:
        nodes = run._playing.lab.nodes.values()
        return [each for each in nodes if getattr(each.device, "axis", None) is not None]

    def gone() -> None:
        for node in drives():
            if node.device.axis in axes:
                node.device.objects.find(0x1016, 2).value = 0
                node._start_watches()

    config, _ = configured("config/can.yaml", **BRIEF, **{"supervisor.policy": "require"})
    run = Run(config, load_scenario("hold"), gone, at=0.1)
    waits: set[int] = set()
    seen = played(run, lambda: waits.update(n.device.objects.number(0x1016, 2) for n in drives()))
    assert Fault.SUPERVISOR_IGNORED in seen.cycle["state"]["fault"]
    assert config.supervisor is not None
    wanted = config.supervisor.node_id << 16 | config.supervisor.timeout_ms
    if len(axes) == 8:
        assert armed_again(seen)
    assert waits <= {wanted}


@pytest.mark.parametrize("policy", ["require", "use"])
@pytest.mark.parametrize("welded", ["both", "one"])
def test_a_relay_with_a_welded_contact(
    welded: str,
    policy: str,
    played: Play,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Both, or an output that stays on: the drives keep their torque. One of them: they lose it,
    and the mirror contact goes on saying that it is closed. Until 2026-11-28 a reset armed both."""
    set_contacts = Relay._set_contacts

    def stuck(relay: Relay, *, closed: bool) -> None:
        set_contacts(relay, closed=closed or bool(run.changed_ns))

    def begin() -> None:
        if welded == "both":
            run.node()._switched = lambda _: None

    if welded == "one":
        monkeypatch.setattr(Relay, "_set_contacts", stuck)
    own = {"sto_relay.timeout_ms": 7, "supervisor.policy": policy}
    config, _ = configured(PATH, **BRIEF, **own)
    run = RelayRun(config, load_scenario("hold"), begin, at=0.1)
    seen = played(run)
    assert not armed_again(seen)
    assert any("a contact is welded" in text for text in events(seen, "recovery_failed"))
    assert any("sto relay" in text for text in events(seen, "refused"))


def test_a_relay_in_order_is_armed_again(played: Play) -> None:
    config, _ = configured(PATH, **BRIEF, **{"sto_relay.timeout_ms": 7})
    run = RelayRun(config, load_scenario("hold"), lambda: None, at=0.1)
    seen = played(run)
    assert armed_again(seen)
    assert not events(seen, "recovery_failed")
