"""Whether the relay of the STO inputs suits supervisor and fieldbus, and how fast it is."""

from __future__ import annotations

from collections.abc import Iterator

from tonus.config import Config
from tonus.config.schema.bus import CanopenBus, of_kind
from tonus.config.schema.sto_relay import StoRelay
from tonus.config.schema.supervisor import Supervisor
from tonus.config.timeouts import least_node_timeout_ms, node_timeout_ms
from tonus.tools.check.finding import Finding

_RULE = _KEY = "sto_relay"
_LONGEST_MS = 50.0
"""that drives keep their torque after the output is off. R: with 100 ms 690 N in all reach 353 N,
with 37 ms 198 N"""


def check_relay(config: Config) -> Iterator[Finding]:
    """Nothing where no supervisor holds one."""
    relay, supervisor = config.relay, config.supervisor
    if relay is None or supervisor is None:
        return
    buses = of_kind(config.fieldbus, CanopenBus)
    on_can = sorted(axis for bus in buses for axis in bus.devices[0])
    if on_can:
        named = ", ".join(map(str, on_can))
        yield Finding(
            _RULE,
            False,
            _KEY,
            f"axes {named} are on CAN: with a relay it reads no frames of drives",
            "remove it: drives on CAN wait for the supervisor's heartbeat",
        )
    names = [name for bus in config.fieldbus.parts for name in bus.can_channels]
    yield Finding(
        _RULE,
        relay.channel not in names,
        f"{_KEY}.channel",
        f"its node is on {relay.channel}"
        + (", a channel of the fieldbus" if relay.channel in names else ", alone"),
        "give it a channel of its own: what floods another would keep its output from the relay",
    )
    yield Finding(
        _RULE,
        supervisor.node_id not in (relay.node_id, relay.master.node_id),
        f"{_KEY}.node_id",
        f"node {relay.node_id}, the master's is {relay.master.node_id}, the supervisor's "
        f"{supervisor.node_id}",
        "give each its own",
    )
    least = 2 * supervisor.period_ms + 1
    yield Finding(
        _RULE,
        relay.timeout_ms >= least,
        f"{_KEY}.timeout_ms",
        f"it waits {relay.timeout_ms} ms for a heartbeat sent every {supervisor.period_ms} ms; "
        f"with one lost it needs {least} ms",
        f"set it to at least {least}",
    )
    yield _silence(config, relay)
    yield from _times(relay, supervisor)


def _silence(config: Config, relay: StoRelay) -> Finding:
    tolerance = config.tolerance
    waits = node_timeout_ms(relay, relay.master, tolerance)
    least = least_node_timeout_ms(relay, tolerance)
    return Finding(
        _RULE,
        waits >= least,
        f"{_KEY}.master.heartbeat_periods",
        f"the robot is stopped after {waits} ms without its node's heartbeat, sent every "
        f"{relay.heartbeat_ms} ms; {tolerance.lost.heartbeat} lost and {tolerance.jitter_ms} ms of "
        f"jitter need {least} ms",
        "leave it out, or set it higher",
    )


def _times(relay: StoRelay, supervisor: Supervisor) -> Iterator[Finding]:
    after_ms = relay.release_ms + relay.torque_off_ms
    dead_ms = relay.timeout_ms + after_ms
    late_ms = supervisor.patience_ms + supervisor.period_ms
    still_ms = late_ms + after_ms
    longest_ms = min(_LONGEST_MS, supervisor.disarmed_ms)
    yield Finding(
        _RULE,
        True,
        _KEY,
        f"no drive has torque {dead_ms:g} ms after the supervisor's end at the latest, "
        f"{still_ms:g} ms after the daemon's last record; {late_ms:g} ms later if it looks as late "
        "as SUP-24 lets it",
        "",
    )
    yield Finding(
        _RULE,
        after_ms <= longest_ms,
        f"{_KEY}.release_ms",
        f"a drive has torque for {after_ms:g} ms after the output is off, {relay.release_ms:g} ms "
        f"until the contacts are open and {relay.torque_off_ms:g} ms (torque_off_ms) from there; "
        f"it may for {longest_ms:g} ms, and no longer than supervisor.disarmed_ms",
        "choose a faster relay, or faster STO inputs",
    )
