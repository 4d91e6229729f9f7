"""Whether the supervisor can stop every drive, and only for a reason."""

from __future__ import annotations

from collections.abc import Iterator

from tonus.config import Config
from tonus.config.schema.bus import CanopenBus
from tonus.config.schema.bus.base import numbers
from tonus.config.schema.supervisor import Supervisor
from tonus.tools.check.finding import Finding

_KEY = "supervisor"


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
    on_can = {
        axis
        for bus in config.fieldbus.parts
        if bus.heartbeats
        for axis in numbers(list(bus.nodes()))[0]
    }
    others = sorted(set(range(config.robot.cables)) - on_can)
    if others and config.lab is None and settings.policy == "require" and config.relay is None:
        yield Finding(
            "supervisor",
            False,
            f"{_KEY}.policy",
            f"without a relay it cannot stop axes {', '.join(map(str, others))}, not on CAN",
            "add sto_relay: !include sto_relay.yaml where no drive is on CAN; else write "
            "supervisor.policy under relaxed, and set it to use or off",
        )


def _wide(config: Config, settings: Supervisor) -> Iterator[Finding]:
    """The bounds of every state, against those of the envelope."""
    envelope = config.control.envelope
    for key, bound, times in (
        ("tension_stopping", config.control.tension.max, 3.0),
        ("contact_stopping", envelope.contact_limit, 2.0),
        ("speed_stopping", envelope.speed_limit, 10.0),
    ):
        value = getattr(settings, key)
        if value > times * bound and config.lab is None:
            text = f"{value:g} is more than {times:g} times the envelope's {bound:g}"
            remedy = f"set it to at most {times * bound:g}"
            yield Finding("supervisor", False, f"{_KEY}.{key}", text, remedy)


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
