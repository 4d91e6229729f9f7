"""Whether one lost frame of any kind can stop the robot: timeouts against periods and tolerance."""

from __future__ import annotations

from collections.abc import Iterator

from tonus.config import Config
from tonus.config.schema.bus import CanopenBus, EthercatBus, FieldbusSection
from tonus.config.schema.drive import Device, DriveProfile
from tonus.config.timeouts import (
    least_master_timeout_ms,
    least_node_timeout_ms,
    least_watchdog_ms,
    master_timeout_ms,
    node_timeout_ms,
    watchdog_ms,
)
from tonus.tools.check.finding import Finding

LEAST_JITTER_TICKS = 2
"""A heartbeat leaves in a tick, and with the lowest priority waits for a cycle's other frames."""


def check_losses(config: Config) -> Iterator[Finding]:
    """Every rule's outcome, in a fixed order; nothing raises."""
    buses = [bus for bus in config.fieldbus.parts if bus.lost_frames(config.tolerance.lost)]
    if buses:
        yield _jitter(config, buses)
        yield from _process_data(config, buses)
    yield from _tracker(config)


def check_interpolation(bus: FieldbusSection) -> Iterator[Finding]:
    """Of each profile, that a drive goes on without one set-point; nothing raises."""
    if bus.devices[0]:
        for key, profile in bus.every_profile.items():
            yield _interpolation(key, profile)


def _jitter(config: Config, buses: list[FieldbusSection]) -> Finding:
    tick_ms = config.control.rates.period_us * 1e-3
    drives = (profile for bus in buses for profile in bus.every_profile.values())
    margin = max(profile.heartbeat_margin_ms for profile in drives)
    least = max(margin, LEAST_JITTER_TICKS * tick_ms)
    jitter = config.tolerance.jitter_ms
    return Finding(
        "jitter",
        jitter >= least,
        "tolerance.jitter_ms",
        f"a heartbeat may be {jitter} ms late, drives and ticks need {least:g} ms",
        f"set it to at least {least:g}",
    )


def _process_data(config: Config, buses: list[FieldbusSection]) -> Iterator[Finding]:
    tolerance, freshness = config.tolerance, config.control.freshness
    kinds: dict[str, int] = {}
    for bus in buses:
        kinds |= bus.lost_frames(tolerance.lost)
    most = max(kinds.values())
    least, fresh = tolerance.fresh_ticks(most), freshness.measurement_ticks
    told = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
    yield Finding(
        "lost frames",
        fresh >= least,
        "control.freshness.measurement_ticks",
        f"a measurement is usable for {fresh} ticks; {told} lost in a row, and "
        f"{tolerance.late_ticks} ticks of delay, need {least}",
        f"set it to at least {least}",
    )
    stop = freshness.stale_stop_ticks
    yield Finding(
        "lost frames",
        stop >= fresh,
        "control.freshness.stale_stop_ticks",
        f"the robot stops after {stop} ticks without a measurement, which is usable for {fresh}",
        f"set it to at least {fresh}",
    )


def _interpolation(key: str, profile: DriveProfile) -> Finding:
    set_to = profile.interpolation_ms
    text = "0x60C2 is 0: a drive goes on without one set-point"
    if set_to is None:
        text = "0x60C2 stays as it is in the drive: a plain drive goes on without one set-point"
    elif set_to:
        text = f"0x60C2 is {set_to} ms: one lost set-point is an error of the drive (0x8250)"
    return Finding("interpolation", not set_to, f"{key}.interpolation_ms", text, "set it to 0")


def check_heartbeats(config: Config, bus: CanopenBus) -> Iterator[Finding]:
    """That no lost heartbeat stops a drive or a node; nothing raises."""
    tolerance = config.tolerance
    needed = f"{tolerance.lost.heartbeat} lost and {tolerance.jitter_ms} ms of jitter need"
    least = least_master_timeout_ms(bus, tolerance)
    for key, profile in bus.every_profile.items():
        if not profile.watches_master:
            yield Finding(
                "heartbeat",
                config.lab is not None,
                f"{key}.watches_master",
                f"{profile.name} has no heartbeat consumer: nothing stops it without the daemon",
                "use a drive that has 0x1016, or EtherCAT",
            )
            continue
        waits = master_timeout_ms(bus, profile, tolerance)
        yield Finding(
            "heartbeat",
            waits >= least,
            f"{key}.master_timeout_ms",
            f"drives wait {waits} ms for the master's heartbeat, sent every "
            f"{bus.master.heartbeat_ms} ms; {needed} {least} ms",
            f"leave it out, or set it to at least {least}",
        )
    watched: list[Device] = []
    axes, cells = bus.devices
    if axes:
        watched += bus.every_profile.values()
    if cells:
        watched.append(bus.force_cell)
    for device in watched:
        waits = node_timeout_ms(device, bus.master, tolerance)
        least = least_node_timeout_ms(device, tolerance)
        yield Finding(
            "heartbeat",
            waits >= least,
            "fieldbus.master.heartbeat_periods",
            f"the master waits {waits} ms for a node's heartbeat, sent every "
            f"{device.heartbeat_ms} ms; {needed} {least} ms",
            "leave it out, or set it higher",
        )


def check_watchdog(config: Config, bus: EthercatBus) -> Iterator[Finding]:
    """That no lost frame stops a slave; nothing raises."""
    tolerance, period_us = config.tolerance, config.control.rates.period_us
    waits = watchdog_ms(bus, tolerance, period_us)
    fresh_ms = config.control.freshness.measurement_ticks * period_us * 1e-3
    # The freshness acts first: a drive that leaves OP is a longer way back than a stale sample.
    least = max(least_watchdog_ms(tolerance, period_us), int(fresh_ms) + 1)
    yield Finding(
        "watchdog",
        waits >= least,
        "fieldbus.master.watchdog_ms",
        f"drives wait {waits} ms for outputs, sent every {period_us * 1e-3:g} ms; "
        f"{tolerance.lost.ethercat} lost, {tolerance.jitter_ms} ms of jitter and measurements "
        f"usable for {fresh_ms:g} ms need {least} ms",
        f"leave it out, or set it to at least {least}",
    )


def _tracker(config: Config) -> Iterator[Finding]:
    tracker, tolerance = config.tracker, config.tolerance
    lost = tolerance.lost.tracker
    least = tolerance.timeout_ms(1e3 / tracker.rate_hz, lost) + tracker.latency_ms
    yield Finding(
        "tracker",
        tracker.maximum_age_ms >= least,
        "tracker.maximum_age_ms",
        f"a pose counts for {tracker.maximum_age_ms:g} ms; {lost} lost of {tracker.rate_hz:g} Hz, "
        f"a latency of {tracker.latency_ms:g} ms and {tolerance.jitter_ms} ms of jitter need "
        f"{least:g} ms",
        f"set it to at least {least:g}",
    )
    sequence = config.control.sequence
    come = int(sequence.referencing_average_s * tracker.rate_hz) - lost
    yield Finding(
        "tracker",
        come >= sequence.referencing_poses,
        "control.sequence.referencing_poses",
        f"referencing averages {sequence.referencing_poses} poses or more; with {lost} lost {come} "
        f"come in {sequence.referencing_average_s:g} s",
        "average for longer (referencing_average_s), or ask for fewer",
    )
