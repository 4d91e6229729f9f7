"""Bus events on their way to a person: named, bounded in number, and repeated ever more rarely."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass

from tonus.drivers.fieldbus import BusEvent

CAPACITY = 256
"""Events kept between two calls of `take`; what does not fit is counted and said."""


@dataclass(frozen=True)
class Meaning:
    """What an event's name stands for, what Tonus does about it, and what a person should do; ""
    for nothing."""

    meaning: str
    reaction: str
    remedy: str = ""


_AGES = "measurements age; beyond the freshness the axis or cell is lost"
_UNUSED = "not used; the measurement ages"
_LOST = "its axis or cells are lost until a reset brings it back"

EVENTS: dict[str, Meaning] = {
    "missing_pdo": Meaning(
        "a SYNC went without an answer in its period",
        _AGES,
        "single ones: watch how often; many: check cable, termination and bus load",
    ),
    "late_pdo": Meaning(
        "an answer came after the next SYNC",
        "counted as old as the oldest open SYNC",
        "check the bus load (`tonus check`) and the node's own cycle",
    ),
    "duplicate_pdo": Meaning(
        "a second answer to one SYNC",
        "not used",
        "look for a second node with the same number, or a frame that is repeated",
    ),
    "short_pdo": Meaning(
        "a PDO shorter than its mapping",
        _UNUSED,
        "compare the node's PDO mapping with its profile; reset to configure it again",
    ),
    "long_pdo": Meaning(
        "a PDO longer than its mapping",
        _UNUSED,
        "compare the node's PDO mapping with its profile; reset to configure it again",
    ),
    "foreign_frame": Meaning(
        "a frame with an unknown COB-ID",
        "not used",
        "find the device that sends it, or give it another COB-ID",
    ),
    "silent_pdo": Meaning(
        "a node sends its heartbeat but answers no SYNC",
        "its axis or cells are lost",
        "check the node's SYNC COB-ID and transmission type; reset to configure it again",
    ),
    "emcy": Meaning(
        "an emergency message",
        "",
        "look the error code up in the device's manual",
    ),
    "short_emcy": Meaning(
        "an emergency message cut short",
        "not used",
        "update the device's firmware; look at the cable if other frames are damaged",
    ),
    "heartbeat_lost": Meaning(
        "a node's heartbeat is missing",
        "its axis is lost; cells as they age",
        "check the node's power and cable; then reset",
    ),
    "heartbeat_back": Meaning("a node's heartbeat is received again", ""),
    "boot_up": Meaning(
        "a node restarted and lost its configuration",
        _LOST,
        "find why the node restarted (supply, watchdog, emergency message before); then reset",
    ),
    "left_operational": Meaning(
        "a node left NMT operational",
        "its axis or cells are lost until it returns or is reset",
        "find who commanded it, or the node's error; then reset",
    ),
    "operational_again": Meaning("a node returned to operational, configured as it was", ""),
    "recovered": Meaning("a reset brought a node back to operational", ""),
    "recovery_failed": Meaning(
        "a reset could not bring a node back",
        "it stays as it is",
        "check the node's power, cable and number; reset again",
    ),
    "transmit_refused": Meaning(
        "the controller refused a frame",
        "the frame is dropped; the devices' watchdogs act",
        "check that the bus is connected and terminated; look at the bus load",
    ),
    "bus_error": Meaning(
        "the controller reports errors on the wire",
        "",
        "check cable, termination, bit rate and shielding",
    ),
    "bus_passive": Meaning(
        "the controller is error-passive",
        "the exchange goes on; check the cable",
        "check cable, termination, bit rate and shielding",
    ),
    "bus_off": Meaning(
        "the controller has left the bus",
        "every axis and cell of the channel goes stale",
        "correct the short circuit, the cable or the bit rate; then reset",
    ),
    "bus_recovered": Meaning("the controller is error-active again", ""),
    "bus_deaf": Meaning(
        "receive failure: nothing can be received on a channel",
        _AGES,
        "check the CAN interface and its driver; then reset",
    ),
    "bus_flooded": Meaning(
        "receive overrun: a channel is full of frames with unknown COB-IDs",
        _AGES,
        "find and disconnect the device that sends these frames",
    ),
    "bus_stalled": Meaning(
        "no node of a channel answers",
        "its axes and cells are lost; frames not yet sent are dropped",
        "check the channel's cable and the nodes' power; then reset",
    ),
    "frame_lost": Meaning(
        "an EtherCAT frame did not come back in time (CAN: missing_pdo)",
        _AGES,
        "single ones: watch how often; many: check cables, connectors and the network card",
    ),
    "stale_frame": Meaning(
        "an EtherCAT frame of an earlier tick came back",
        _UNUSED,
        "check the network card's settings and the host's load (`tonus doctor`)",
    ),
    "wrong_working_counter": Meaning(
        "fewer slaves took part in an exchange than should",
        "its inputs are not used until it is known who is missing, then those of the others are",
        "look which slave is missing (next events); check its power and cable",
    ),
    "slave_silent": Meaning(
        "a slave takes no part in any exchange",
        _LOST,
        "check the slave's power and cable; then reset",
    ),
    "ring_open": Meaning(
        "a cable of a ring is disconnected; every slave is reached from one end or the other",
        "the exchange goes on as far as the master can; one more cable stops the robot",
        "connect the cable again soon: the ring tolerates one",
    ),
    "ring_closed": Meaning("all cables of a ring are connected again", ""),
    "slave_left_op": Meaning(
        "a slave left OP, with its AL status code",
        "its axis is lost until it is in OP again",
        "look the AL status code up; then reset",
    ),
    "slave_recovered": Meaning("a slave is in OP again", ""),
    "slave_given_up": Meaning(
        "a slave left OP more often than it is brought back",
        "it stays as it is until a reset",
        "correct the cause that the AL status code names; then reset",
    ),
    "drive_error": Meaning(
        "a drive's error code (0x603F)",
        "",
        "look the code up in the drive's manual; correct the cause, then reset",
    ),
    "clock_astray": Meaning(
        "a slave's distributed clock is out of sync with the reference",
        "the exchange goes on; its SYNC0 is off",
        "look at the host's timing (`tonus doctor`) and the slave's clock support",
    ),
    "frame_near_sync": Meaning(
        "process data pass close to SYNC0",
        "a sample may be a tick older than counted",
        "change fieldbus.clocks.shift_us, or lighten the host's load",
    ),
    "non_finite_torque": Meaning(
        "control commanded a torque that is not a finite number",
        "it gets 0",
        "report it with the log: control should never do this; check a controller of your own",
    ),
    "tracker_malformed": Meaning(
        "a tracker datagram that is malformed or not plausible",
        "not used",
        "check who else sends to tracker.port, and the tracker's output format",
    ),
    "tracker_second_sender": Meaning(
        "another program sends datagrams to the tracker's port",
        "not used while the first sender goes on",
        "stop it, or give it another tracker.port; a lab that still runs is the usual one",
    ),
    "tracker_receive_failure": Meaning(
        "the tracker's socket reports an error",
        "the estimate rests on the cables meanwhile",
        "check the network interface and its address",
    ),
    "supervisor_stopped": Meaning(
        "the supervisor found a requirement broken and stops the drives",
        "its heartbeat has ended; the drives brake and disable by themselves, or have no torque "
        "(sto_relay)",
        "look the requirement up in supervisor.md; keep the log: daemon or supervisor is wrong. "
        "Its heartbeat does not begin again before a reset",
    ),
    "supervisor_lost": Meaning(
        "no heartbeat of the supervisor on a channel",
        "the drives there brake and disable by themselves, or have no torque (sto_relay)",
        "look whether its process runs, and at the channel; a reset arms nothing without it",
    ),
    "unsupervised": Meaning(
        "drives are enabled while supervisor.policy is use and its heartbeat has not begun on a "
        "channel",
        "the run continues without it there",
        "look whether its process runs (beside a lab in real time none does on fewer than "
        "supervisor.processors); give it supervisor.quiet_s with the drives off to begin",
    ),
    "supervisor_back": Meaning(
        "the supervisor's heartbeat is received again",
        "",
        "",
    ),
    "sto_relay_open": Meaning(
        "the relay in the circuit of the STO inputs opened while the drives were enabled",
        "every drive reports STO",
        "look for supervisor_stopped or supervisor_lost beside it, else at the relay's node and "
        "its wires; then reset",
    ),
    "sto_relay_stuck": Meaning(
        "the relay in the circuit of the STO inputs reports closed contacts with its output off",
        "the robot is not armed",
        "replace the relay: a contact is welded, or the wire of its mirror contact is broken",
    ),
    "dropped": Meaning(
        "more events than can be kept between two ticks",
        "counted",
        "look for the cause in the first events of the flood",
    ),
}
"""Every name a driver reports. The reaction ends the event's text."""


class EventLog:
    """Collects events in the tick without letting a flood grow memory or the log."""

    def __init__(self, own: Mapping[str, Meaning] | None = None) -> None:
        """``own``: names beside `EVENTS` that this driver reports."""
        self._meanings = EVENTS | dict(own or {})
        self._pending: list[BusEvent] = []
        self._dropped = 0
        self._counts: dict[Hashable, int] = {}
        self._episodes: set[Hashable] = set()

    def add(self, name: str, where: str, text: str) -> None:
        if len(self._pending) < CAPACITY:
            reaction = self._meanings[name].reaction
            self._pending.append(BusEvent(name, where, f"{text}; {reaction}" if reaction else text))
        else:
            self._dropped += 1

    def counted(self, name: str, where: str, text: str, *, kind: Hashable = None) -> None:
        """Report the 1st, 2nd, 4th, 8th ... occurrence of this name and kind at this place.

        Beyond `CAPACITY` of them all others of one name are counted together.
        """
        key: Hashable = (name, where, kind)
        if key not in self._counts and len(self._counts) >= CAPACITY:
            key = name
        count = self._counts.get(key, 0) + 1
        self._counts[key] = count
        if count & (count - 1) == 0:
            self.add(name, where, text if count == 1 else f"{text} ({count} so far)")

    def begin(self, name: str, where: str, text: str) -> None:
        """Report once; again only after `end` of the same name and place."""
        if (name, where) not in self._episodes:
            self._episodes.add((name, where))
            self.counted(name, where, text)

    def end(self, name: str, where: str) -> bool:
        """True if there was an episode to end."""
        if self._episodes and (name, where) in self._episodes:
            self._episodes.remove((name, where))
            return True
        return False

    def take(self) -> list[BusEvent]:
        if not self._pending:
            return []
        taken, self._pending = self._pending, []
        if self._dropped:
            taken.append(BusEvent("dropped", "events", f"{self._dropped} more were not kept"))
            self._dropped = 0
        return taken
