"""What devices have become beside the bring-up, and what the heartbeat waits for after a stop."""

from __future__ import annotations

from tonus.config.schema.supervisor import Requirement
from tonus.runtime.states import ARMED, Operator, State
from tonus.runtime.supervisor.devices import Boots
from tonus.runtime.supervisor.judge import NOWHERE, Violation
from tonus.runtime.supervisor.observation import Observation
from tonus.runtime.supervisor.record import CONTROLLED, Claim


class Changes:
    """Call it once a look (SUP-27)."""

    def __init__(self, boots: Boots, quiet_s: float) -> None:
        self._boots = boots
        self._quiet_ns = quiet_s * 1e9
        self._recorded = False
        """there was a record before this look, not of FAULT"""
        self._changed: Violation | None = None
        """since then, until the next record"""
        self._unreset = False
        """it stopped the robot, and no reset was recorded since"""
        self._resetting = True
        """in the newest record; one that is recorded in every tick is nobody's"""
        self._failed = False
        """in the newest record: in any other state a daemon takes no reset"""
        self._restarted = self._forgetful = self._unpowered = False
        """a device has booted since the last record of FAULT; a state without control was recorded
        then; and no drive had power at a look"""
        self._foul: Violation | None = None
        """others commanded devices, or wrote to them, and FAULT, in which a daemon brings them up
        again, was not recorded since"""
        self._told: Violation | None = None
        """what of that was told last"""
        self._told_ns = 0
        """when"""
        self._unbooted: set[tuple[str, int]] = set()
        """heartbeats of devices that have not booted since"""
        self._standing = False
        """the newest record is of STANDBY"""

    @property
    def awaited(self) -> bool:
        """A reset, or a bring-up, without which the heartbeat does not begin."""
        return bool(self._foul or self._unbooted or self._unreset)

    def __call__(self, seen: Observation, changed: Violation | None) -> Violation | None:
        """A download, or a command of the network (``changed``), between records that are not of
        FAULT, in which alone a daemon makes some: the device is no longer what the bring-up has
        made of it. However long the record pauses, it counts once that goes on."""
        newest, claims = seen.claim, seen.claims
        self._unbooted -= self._boots.found
        recovered = any(claim.state == State.FAULT for claim in claims)
        if recovered:
            self._foul = None
        for claim in claims:
            reset = claim.operator == Operator.RESET
            taken = reset and self._failed and claim.state == State.STANDBY
            self._unreset &= not (taken and not self._resetting)
            self._resetting, self._failed = reset, claim.state == State.FAULT
        self._note_restarts(claims, recovered=recovered, powered=bool(seen.enabled.any()))
        found = self._changed if claims and not (recovered or self._foul) else None
        if claims:
            self._changed = None
        if self._recorded:
            self._changed = self._changed or changed
        self._recorded = newest is not None and newest.state != State.FAULT
        self._standing = newest is not None and newest.state == State.STANDBY
        return found

    def _note_restarts(self, claims: list[Claim], *, recovered: bool, powered: bool) -> None:
        """A device that restarts has lost what the bring-up made of it. The daemon answers with
        FAULT, if only after a stop; one that is armed again without that counts as changed."""
        if self._recorded:
            self._restarted |= bool(self._boots.found)
        if recovered:
            self._restarted = self._forgetful = self._unpowered = False
        for claim in claims:
            self._forgetful |= self._restarted and claim.state not in CONTROLLED
            forgetful = self._forgetful and claim.state in CONTROLLED
            if forgetful or (self._unpowered and powered and claim.state in ARMED):
                self._changed = self._changed or Violation(Requirement.COMMANDED, NOWHERE, 0.0)
        self._unpowered |= self._restarted and not powered

    def stop(self, found: Violation, looked_ns: int) -> bool:
        """The robot was stopped. Whether others did it, and that is to be told everywhere."""
        self._unreset = True
        first = found.requirement is Requirement.COMMANDED and not self._foul
        if first:
            self._foul = self._told = found
            self._told_ns, self._unbooted = looked_ns, self._boots.devices
        return first

    def again(self, now_ns: int) -> Violation | None:
        """What others have done, each ``quiet_s``: a frame may be lost. After FAULT only in STANDBY
        while devices have not booted, since the daemon does not know then that it has to bring
        them up; in FAULT it may be doing so, and would have to do it once more."""
        known = self._foul is None and not (self._unbooted and self._standing)
        if known or now_ns - self._told_ns < self._quiet_ns:
            return None
        self._told_ns = now_ns
        return self._told
