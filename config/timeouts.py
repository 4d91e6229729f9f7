"""How long drives, nodes and slaves are waited for, and wait: from periods and the tolerance.

A value that a configuration states itself stands; `tonus check` holds it to the derived one.
"""

from __future__ import annotations

from tonus.config.schema.bus import CanopenBus, EthercatBus, Master
from tonus.config.schema.drive import Device, DriveProfile
from tonus.config.schema.tolerance import Tolerance


def least_master_timeout_ms(bus: CanopenBus, tolerance: Tolerance) -> int:
    """The shortest 0x1016 of the drives for the daemon's heartbeat."""
    return tolerance.timeout_ms(bus.master.heartbeat_ms, tolerance.lost.heartbeat)


def master_timeout_ms(bus: CanopenBus, profile: DriveProfile, tolerance: Tolerance) -> int:
    """0x1016 of a drive of the bus."""
    return profile.master_timeout_ms or least_master_timeout_ms(bus, tolerance)


def least_node_timeout_ms(device: Device, tolerance: Tolerance) -> int:
    """The shortest time after which a node without a heartbeat is silent."""
    return tolerance.timeout_ms(device.heartbeat_ms, tolerance.lost.heartbeat)


def node_timeout_ms(device: Device, master: Master, tolerance: Tolerance) -> int:
    """The time after which a node without a heartbeat is silent."""
    if master.heartbeat_periods is not None:
        return master.heartbeat_periods * device.heartbeat_ms
    return least_node_timeout_ms(device, tolerance)


def least_watchdog_ms(tolerance: Tolerance, period_us: int) -> int:
    """The shortest sync manager watchdog of a segment whose outputs come each ``period_us``."""
    return tolerance.timeout_ms(period_us * 1e-3, tolerance.lost.ethercat)


def watchdog_ms(bus: EthercatBus, tolerance: Tolerance, period_us: int) -> int:
    """Sync manager watchdog of the slaves."""
    return bus.master.watchdog_ms or least_watchdog_ms(tolerance, period_us)
