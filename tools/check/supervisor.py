"""Whether the supervisor can stop every drive, and only for a reason."""

from __future__ import annotations

from collections.abc import Iterator

from tonus.config import Config
from tonus.config.schema.bus import CanopenBus
from tonus.config.schema.bus.base import numbers
from tonus.config.schema.supervisor import Supervisor
from tonus.tools.check.finding import Finding

_KEY = "supervisor"
_SHARES = (
    ("unexplained_force", 0.5),
    ("opposed_force", 0.5),
    ("opposed_error", 0.1),
    ("logged_tension", 0.25),
    ("answered_torque", 0.25),
    ("tension_stopping", 3.0),
)
"""of the largest tension, at most"""


def check_supervisor(config: Config) -> Iterator[Finding]:
    """Whether there is one, and whether every drive is within its reach."""
    settings = config.supervisor
    if settings is None or settings.policy == "off":
        named = config.lab is not None or "supervisor.policy" in config.relaxed
        yield Finding(
            "supervisor",
            named,
            _KEY,
            "nothing but the daemon itself judges what the daemon does",
            "add supervisor: !include supervisor.yaml, or write supervisor.policy under relaxed",
        )
        return
    yield from _wide(config, settings)
    if config.lab is not None or settings.policy != "require" or config.relay is not None:
        return
    parts = [numbers(list(bus.nodes())) for bus in config.fieldbus.parts if bus.heartbeats]
    others = sorted(set(range(config.robot.cables)) - {each for axes, _ in parts for each in axes})
    unread = sorted(set(range(config.robot.cells)) - {each for _, cells in parts for each in cells})
    if unread and not others:
        yield Finding(
            "supervisor",
            False,
            f"{_KEY}.policy",
            f"it does not read load cells {', '.join(map(str, unread))}, which are not on CAN: no "
            "bound of tension or contact is judged by them",
            "connect them to a channel of the drives; else write supervisor.policy under relaxed, "
            "and set it to use or off",
        )
    if others:
        yield Finding(
            "supervisor",
            False,
            f"{_KEY}.policy",
            f"without a relay it cannot stop axes {', '.join(map(str, others))}, not on CAN",
            "add sto_relay: !include sto_relay.yaml where no drive is on CAN; else write "
            "supervisor.policy under relaxed, and set it to use or off",
        )


def _wide(config: Config, settings: Supervisor) -> Iterator[Finding]:
    """Its bounds against those of tension and envelope."""
    if config.lab is not None:
        return
    control = config.control
    envelope, stiffness, tension = control.envelope, control.stiffness, control.tension.max
    tare, rise = control.sequence.tare_limit, stiffness.rise_rate
    for key, value, bound, times in (
        *((f"{_KEY}.{name}", getattr(settings, name), tension, times) for name, times in _SHARES),
        (f"{_KEY}.contact_stopping", settings.contact_stopping, envelope.contact_limit, 2.0),
        (f"{_KEY}.speed_stopping", settings.speed_stopping, envelope.speed_limit, 10.0),
        ("control.sequence.tare_limit", tare, envelope.contact_limit, 0.5),
        ("control.stiffness.rise_rate", rise, stiffness.maximum - stiffness.minimum, 10.0),
    ):
        if value > times * bound:
            text = f"{value:g} is more than {times:g} times the bound of {bound:g} that it guards"
            remedy = f"set it to at most {times * bound:g}"
            yield Finding("supervisor", False, key, text, remedy)


def check_watches(config: Config, bus: CanopenBus) -> Iterator[Finding]:
    """Whether the drives of a bus wait for it, and no shorter than they can."""
    settings = config.supervisor
    if settings is None or settings.policy == "off" or not bus.axis_places:
        return
    for key, profile in bus.every_profile.items():
        if not profile.watches_supervisor:
            yield Finding(
                "supervisor",
                config.lab is not None,
                f"{key}.watches_supervisor",
                f"{profile.name} has no second heartbeat consumer: the supervisor cannot stop it",
                "use a drive that has 0x1016:2",
            )
            continue
        yield _patience(settings, profile.heartbeat_margin_ms, profile.name)


def _patience(settings: Supervisor, margin_ms: float, name: str) -> Finding:
    least = settings.period_ms + margin_ms
    return Finding(
        "supervisor",
        settings.timeout_ms >= least,
        f"{_KEY}.timeout_ms",
        f"drives wait {settings.timeout_ms} ms for its heartbeat, sent every {settings.period_ms} "
        f"ms; {name} needs {least:g} ms",
        f"set it to at least {least:g}",
    )
