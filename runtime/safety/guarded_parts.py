"""The parts of the daemon that a firewall keeps from control."""

from __future__ import annotations

from tonus.runtime.safety.firewall import Firewall


class GuardedParts:
    """Those that bring inputs or commands are never switched off."""

    def __init__(self, firewall: Firewall) -> None:
        part = firewall.part
        self.control = part("control", lasting=True)
        self.fallback = part("fallback", lasting=True)
        self.commander = part("commander", lasting=True)
        self.tracker = part("tracker", lasting=True)
        self.record = part("record")
        self.ring = part("ring")
        self.keyframe = part("keyframe")
        self.reporter = part("reporter")
        self.bus_events = part("fieldbus events")
        self.events = part("events")
        self.self_test = part("self-test")
