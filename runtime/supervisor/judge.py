"""The requirements, each as a condition on one observation, and how long it may hold."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.root import Config
from tonus.config.schema.supervisor import Requirement, Supervisor
from tonus.runtime.states import ARMED, Operator, State, StopMode
from tonus.runtime.supervisor.observation import Observation
from tonus.runtime.supervisor.platform_speed import PlatformSpeed
from tonus.runtime.supervisor.record import CONTROLLED, Claim, Floats

NOWHERE = -1
_STIFF = (State.HOLD, State.ACTIVE)
_REGULATING = CONTROLLED.index(State.HOLD)
"""from HOLD to ACTIVE and back it goes as ordered"""
_AT_ONCE = (
    *(Requirement.TICK, Requirement.TORQUE, Requirement.FROZEN, Requirement.STALE),
    *(Requirement.STIFFNESS, Requirement.STOP_ENDS),
)
"""what lasts already when it is seen, and what may not be for any time"""
FORGETTING, _ANSWERED_FORGETTING, _BURST_FORGETTING = 4, 16, 64
"""times slower than it was counted is the time forgotten for which a condition held; for which a
drive's own figure was not what it was sent; and for which one that has to be off, or to brake,
pulled: its drum keeps the speed of each burst"""
Key = tuple[Requirement, int]
"""requirement and patience in ns: that it is broken at one axis now and then at another is no
excuse"""


@dataclass(frozen=True)
class Violation:
    requirement: Requirement
    where: int
    """axis, or `NOWHERE`"""
    value: float
    alone: bool = False
    """of the channel of that axis, and of no other"""


@dataclass
class _Orders:
    """To stop: those of the operator, and faults, with cables that are given up. All last."""

    stop: int = Operator.NONE
    fault: bool = False
    reached: int = 0
    """the latest state of arming; control goes back to no earlier one"""

    def note(self, claim: Claim) -> None:
        self.fault |= claim.fault != 0
        if claim.state in CONTROLLED:
            place = min(CONTROLLED.index(claim.state), _REGULATING)
            self.fault |= place < self.reached or bool(claim.failed.any())
            self.reached = max(self.reached, place)
        if claim.operator in (Operator.STOP, Operator.ESTOP):
            self.stop = max(self.stop, claim.operator)


class Judge:
    """Call it with each observation while a drive is enabled, `rest` while none is, and `forget`
    once none has been for a while.

    A condition has a patience: how long it may hold. Where it ends its time is forgotten slowly,
    so that one which comes and goes is found too."""

    def __init__(self, config: Config, settings: Supervisor) -> None:
        control = config.control
        self._settings = settings
        self._most_tension = control.tension.max * settings.margin
        self._most_of_a_cable = 2.0 * control.tension.max
        self._most_contact = control.envelope.contact_limit * settings.margin
        self._most_speed = control.envelope.speed_limit * settings.margin
        self._most_stiffness = control.stiffness.maximum * settings.margin
        self._least_stiffness = control.stiffness.minimum / settings.margin
        self._most_rise = control.stiffness.rise_rate * settings.margin
        self._tare = control.sequence.tare_limit
        self._least_tension = control.tension.min / settings.margin
        self._slack, self._passive_tension = control.tension.slack, control.stop.passive_tension
        self._least_damping = control.stop.passive_damping * settings.damped_share
        self._tick_ns = control.rates.period_ns
        self._opposed_ns = round(settings.opposed_ms * 1e6)
        self._pulling_ns = round(settings.patience_ms * 1e6)
        # The daemon's own envelope ends the control of a slack cable after so many ticks.
        self._slack_ns = self._pulling_ns + control.envelope.over_tension_ticks * self._tick_ns
        # Twice what the daemon itself takes for a fault, for twice as long.
        self._astray = 2.0 * control.isolation.tension_error
        self._astray_ns = round(2e9 * control.isolation.tension_error_s)
        self._speed = PlatformSpeed(config)
        self._period_ns = round(settings.period_ms * 1e6)
        # Longer than `_pulling_ns`, of the same requirement, whose time is forgotten more slowly.
        self._unpowered_ns = max(self._opposed_ns, self._pulling_ns + self._period_ns)
        self._timeout_ns = round(settings.timeout_ms * 1e6)
        # An encoder that slips shows a change of motion for as long as the window is.
        self._own_ns = round((settings.window_ms + 2 * settings.period_ms) * 1e6)
        # Apart from how long a descent may turn, which it may do meanwhile.
        self._thrown_ns = 2 * self._opposed_ns + self._period_ns
        self._brakes = config.relay is None
        patience = dict.fromkeys(Requirement, settings.patience_ms) | dict.fromkeys(_AT_ONCE, 0.0)
        # A frame that is lost at an end of the window shows in one look there.
        patience[Requirement.UNEXPLAINED] = settings.period_ms
        # What it compares is a look old already.
        patience[Requirement.COMMAND_LOGGED] = max(0.0, settings.patience_ms - settings.period_ms)
        patience[Requirement.DISARMED] = settings.disarmed_ms
        self._patience_ns = {key: round(value * 1e6) for key, value in patience.items()}
        bursts = (Requirement.DISARMED, Requirement.BRAKED)
        self._slowness = {(each, self._pulling_ns): _BURST_FORGETTING for each in bursts}
        if not self._brakes:  # single frames that are lost do not make it another figure
            logged = Requirement.COMMAND_LOGGED
            self._slowness[logged, self._patience_ns[logged]] = _ANSWERED_FORGETTING
        self._looked_ns: int | None = None
        self._lately = _Orders()
        """since the record was disarmed last"""
        self.forget()
        self._was_controlled = True

    def forget(self) -> None:
        """What held before is over."""
        self._held: dict[Key, int] = {}
        self._was_controlled = False
        self._end_stop()

    def note(self, claims: list[Claim]) -> None:
        """What was recorded since the last look, whether or not a drive is enabled."""
        for claim in claims:
            self._was_controlled |= claim.state in CONTROLLED
            if claim.state in ARMED:
                self._lately.note(claim)
            else:
                self._lately = _Orders()

    def rest(self, now_ns: int) -> None:
        """No drive is enabled: a stop is over, and what held before is forgotten slowly. What was
        ordered since the record was disarmed last is not: power may only be about to come."""
        self._end_stop()
        self._hold(now_ns, set())

    def _end_stop(self) -> None:
        self._stopping_ns: int | None = None
        self._mode: int = StopMode.NONE
        """of the stop, as it was recorded last"""
        self._before: Claim | None = None
        self._tension: Floats | None = None
        """N, of the look before"""
        self._felt_ns = 0
        self._tared: Floats | None = None
        """N, as they were recorded first"""
        self._orders = replace(self._lately)

    def __call__(self, seen: Observation) -> Violation | None:
        """The first requirement that has been broken for longer than it may be; one of a channel
        alone where there is no other."""
        broken: dict[Key, Violation] = {}
        for each, patience_ns in self._broken(seen):
            broken.setdefault((each.requirement, patience_ns), each)
        self._hold(seen.now_ns, broken.keys())
        found = (each for key, each in broken.items() if self._held[key] >= key[1])
        return min(found, key=lambda each: each.alone, default=None)

    def _hold(self, now_ns: int, broken: Collection[Key]) -> None:
        """Count what is broken, and forget what is not."""
        elapsed_ns = 0 if self._looked_ns is None else now_ns - self._looked_ns
        self._looked_ns = now_ns
        least_ns = -min(elapsed_ns, self._period_ns)
        held = {
            key: max(held_ns - elapsed_ns // self._slowness.get(key, FORGETTING), least_ns)
            for key, held_ns in self._held.items()
            if held_ns > least_ns
        }
        for key in broken:
            held[key] = self._held[key] + elapsed_ns if key in self._held else 0
        self._held = held

    def _broken(self, seen: Observation) -> Iterator[tuple[Violation, int]]:
        speeds = self._speed(seen, seen.rate)
        if np.isfinite(seen.travel).any():
            travel = np.where(np.isfinite(seen.travel), seen.travel, seen.rate)
            speeds = tuple(np.fmax(speeds, self._speed(seen, travel)).tolist())
        for each in (
            *self._daemon(seen),
            *self._bus(seen),
            *self._controlled(seen, speeds),
            *self._stopping(seen),
        ):
            yield each, self._patience_ns[each.requirement]
        yield from self._against(seen)
        if seen.claim is not None and self._is_disarmed(seen.claim):
            # A drive takes its time to switch off, but it is sent no torque meanwhile.
            pulling = seen.enabled & seen.pulled
            for each in _at(Requirement.DISARMED, seen, seen.torque, None, pulling):
                yield each, self._pulling_ns
            # Brakes keep what each of several bursts adds.
            fresh = not self._was_controlled  # else its drives are being switched off
            tense = seen.enabled & (seen.tension > self._most_tension) & fresh
            for each in _at(Requirement.TENSION, seen, seen.tension, None, tense):
                yield each, self._pulling_ns
        long_ns = round(self._settings.stopping_ms * 1e6)
        for each in self._always(seen, speeds):
            yield each, long_ns
        yield from self._recorded(seen)
        for limits, patience_ns in self._of_a_stop(seen.claim):
            for each in _faster(speeds, limits):
                yield each, patience_ns
        yield from self._of_taut_cables(seen)
        if seen.claim is not None and seen.claim.state == State.SAFE_STOP:
            # No cable reels in its drum, whatever its cell says: there the drive pulls by itself.
            # When its torque acted within the window does not matter by the largest one.
            own = seen.motion - seen.most_torque
            own -= self._settings.unexplained_share * abs(seen.most_torque)
            reeling = seen.enabled & ~seen.useless & (seen.rate > 0.0)
            limit = self._settings.unexplained_force
            for each in _at(Requirement.UNEXPLAINED, seen, own, limit, reeling):
                yield each, self._own_ns
            # No stop of a daemon in order gets there; a cell that is broken does. Where most report
            # an error they may measure all the same, but not what no cable has.
            most = 2 * seen.defective.sum() >= len(seen.defective)
            defective = seen.defective & (~most | (seen.tension > self._most_of_a_cable))
            for bound, patience_ns in (
                (self._settings.tension_stopping, self._opposed_ns),
                (self._most_tension, 2 * long_ns),
            ):
                tense = (seen.tension > bound) & ~defective
                for each in _at(Requirement.TENSION, seen, seen.tension, None, tense):
                    yield each, patience_ns
        if seen.claim is not None and seen.claim.state in _STIFF:
            loose = seen.enabled & (seen.tension < self._slack)
            for each in _at(Requirement.TENSION, seen, seen.tension, None, loose):
                yield each, self._slack_ns

    def _of_a_stop(self, claim: Claim | None) -> Iterator[tuple[tuple[float, float], int]]:
        """Bounds of speed and turning rate besides the wide ones, and for how long they may be
        exceeded. One along the path that is thrown is soon slower again, or in another stop; a
        passive one lets the platform sink as fast as friction and damping do."""
        settings = self._settings
        if claim is None or claim.state != State.SAFE_STOP or claim.stop_mode == StopMode.PASSIVE:
            return
        if claim.stop_mode == StopMode.ON_PATH:
            yield (settings.speed_on_path, settings.rotation), self._opposed_ns
            return
        yield (settings.speed_in_descent, math.inf), self._pulling_ns
        yield (math.inf, settings.rotation_in_descent), 2 * self._opposed_ns

    def _of_taut_cables(self, seen: Observation) -> Iterator[tuple[Violation, int]]:
        """SUP-8 while controlled, and in a stop that is not passive, by the drums of taut cables
        alone: those of slack ones stand, or turn with the others, while the platform moves. With
        what the cables stretch by it is the platform's speed where it swings on them while the
        drums hardly turn; and without, where slack cables are allowed. A right stop is as fast for
        some ms, where a cable is cut."""
        stretching, claim, settings = self._speed.stretching(seen), seen.claim, self._settings
        if claim is None:
            return
        taut = ~(seen.tension < self._slack)
        if claim.state in CONTROLLED:
            most, turning = self._most_speed, settings.rotation
            patience_ns, drums_ns = self._opposed_ns, self._pulling_ns
        elif claim.state == State.SAFE_STOP and claim.stop_mode != StopMode.PASSIVE:
            most, turning = settings.speed_in_descent, math.inf
            if claim.stop_mode == StopMode.ON_PATH:
                most = settings.speed_on_path
            patience_ns = drums_ns = self._thrown_ns
        else:
            return
        swinging = self._speed(seen, seen.rate, taut, stretching)
        for each in _faster(swinging, (most, turning)):
            yield each, patience_ns
        if claim.state not in _STIFF:
            for each in _faster(self._speed(seen, seen.rate, taut), (most, math.inf)):
                yield each, drums_ns

    def _is_disarmed(self, claim: Claim) -> bool:
        """A stop is of what was controlled: power that begins with it has no measured bound."""
        return claim.state not in ARMED or not (self._was_controlled or claim.state in CONTROLLED)

    def _daemon(self, seen: Observation) -> Iterator[Violation]:
        """Of the record alone: SUP-1, 9, 12, 13, 25."""
        claim, settings = seen.claim, self._settings
        age = np.inf if claim is None else (seen.now_ns - claim.at_ns) * 1e-6
        if not -settings.patience_ms <= age <= settings.patience_ms:  # nor from the future
            yield Violation(Requirement.TICK, NOWHERE, age)
        if claim is None:
            return
        yield from self._stiffness(seen.claims)
        if self._is_disarmed(claim):
            yield Violation(Requirement.DISARMED, NOWHERE, claim.state)
        most = float(np.abs(claim.tare).max())
        if not most <= self._tare:
            yield Violation(Requirement.MEASURED_LOGGED, NOWHERE, most)
        if claim.state in ARMED:
            self._tared = claim.tare if self._tared is None else self._tared
            with np.errstate(invalid="ignore"):
                moved = float(np.abs(claim.tare - self._tared).max())
            if moved > 0.0:
                yield Violation(Requirement.MEASURED_LOGGED, NOWHERE, moved)
        yield from self._stop_ends(seen)
        yield from self._follows(seen.claims, claim)

    def _follows(self, claims: list[Claim], newest: Claim) -> Iterator[Violation]:
        """While power is on nothing ends an order or a fault, whatever the daemon records. A state
        of arming after a later one is a fault of the record, which nothing of the robot's brings
        about; a cable that is given up is one that stops the robot."""
        orders = self._orders
        for claim in claims:
            orders.note(claim)
        ignored = orders.stop == Operator.ESTOP and newest.state in ARMED
        stop = orders.stop == Operator.STOP or orders.fault
        if ignored or (stop and newest.state in CONTROLLED):
            yield Violation(Requirement.ORDERS, NOWHERE, newest.state)

    def _stop_ends(self, seen: Observation) -> Iterator[Violation]:
        """Only power that is off ends a stop, whatever the daemon records, and it never comes back
        to a mode of before."""
        again = False
        for claim in seen.claims:
            again |= self._stopping_ns is not None and claim.state in CONTROLLED
            if claim.state == State.SAFE_STOP:
                again |= claim.stop_mode < self._mode
                self._mode = claim.stop_mode
                if self._stopping_ns is None:
                    self._stopping_ns = seen.now_ns
        if self._stopping_ns is not None:
            lasted = (seen.now_ns - self._stopping_ns) * 1e-9
            if lasted > self._settings.stop_s or again:
                yield Violation(Requirement.STOP_ENDS, NOWHERE, lasted)

    def _stiffness(self, claims: list[Claim]) -> Iterator[Violation]:
        for claim in claims:
            if claim.state not in _STIFF:
                continue
            before, self._before = self._before, claim
            if not self._least_stiffness <= claim.stiffness <= self._most_stiffness:
                yield Violation(Requirement.STIFFNESS, NOWHERE, claim.stiffness)
            if before is not None:
                passed_ns = max(claim.at_ns - before.at_ns, self._tick_ns)
                rise = (claim.stiffness - before.stiffness) / (passed_ns * 1e-9)
                if not rise <= self._most_rise:
                    yield Violation(Requirement.STIFFNESS, NOWHERE, rise)

    def _bus(self, seen: Observation) -> Iterator[Violation]:
        """Of frames, in every state: SUP-2, 3, 10, 14."""
        settings, enabled = self._settings, seen.enabled
        ages = np.sort(seen.torque_age[enabled])
        most_drives = float(ages[(len(ages) - 1) // 2])  # of more than half of them
        if most_drives > settings.patience_ms:
            yield Violation(Requirement.TORQUE, NOWHERE, most_drives)
        yield from _at(Requirement.TORQUE, seen, seen.torque_age, settings.axis_torque_ms, enabled)
        yield from self._frozen(seen)
        # Where nothing is sent and no drive answers the channel is gone: its heartbeat ends alone.
        gone = np.minimum(seen.torque_age, seen.channel_age) > settings.patience_ms
        wrong = enabled & seen.unlogged & ~gone
        # A daemon that is late is so on more than one channel, and one that repeats itself is not
        # late; but zeros may wait in a queue behind which there are others.
        late = wrong & seen.late & ((seen.same < settings.frozen_frames) | (seen.mille == 0))
        beside = enabled & ~seen.together[late].any(axis=0)
        late &= seen.together[np.ix_(late, late)].all() and beside.any()
        yield from _at(Requirement.COMMAND_LOGGED, seen, seen.torque, None, wrong & ~late)
        for each in _at(Requirement.COMMAND_LOGGED, seen, seen.torque, None, late):
            yield replace(each, alone=True)
        # Those of a channel without a heartbeat stop by themselves, whatever comes back with it.
        # One that was not enabled when it answered last may be by now.
        sent = seen.beating & (seen.torque_age < settings.stale_ms) & seen.pulled
        yield from _at(Requirement.STALE, seen, seen.measured_age, settings.stale_ms, sent)
        # Nobody could judge, whatever the torques are. Drives that lose the heartbeat brake; those
        # that lose the relay have no torque, which is what they are sent. One that is disabled
        # answers for none, unless most are: then a stop is at its end, and the rest is SUP-12's.
        most = 2 * enabled.sum() > len(enabled)
        newest = float((seen.measured_age[enabled] if most else seen.measured_age).min())
        if self._brakes and newest > settings.stale_ms:
            yield Violation(Requirement.STALE, NOWHERE, newest)

    def _frozen(self, seen: Observation) -> Iterator[Violation]:
        """SUP-3."""
        settings, enabled, claim = self._settings, seen.enabled, seen.claim
        frozen = enabled & (seen.same >= settings.frozen_frames)
        controlled = claim is not None and claim.state in CONTROLLED[1:]
        # In a stop cables are given up, without torque, and drives work at their limits.
        most = controlled and 2 * (frozen & (seen.mille != 0)).sum() > enabled.sum()
        if not most and frozen.sum() < enabled.sum():
            return
        if claim is not None and claim.state not in CONTROLLED:
            # A drum whose cable is given up has no torque, and moves as it will; also in the last
            # look of a stop, in which the daemon is disarmed already.
            used = frozen & ~(claim.failed[seen.axes] & (seen.mille == 0))
            # Where none is used, drives that lose the relay have what they are sent.
            if used.any() or not self._brakes:
                frozen = used
            frozen = frozen & ~self._at_its_limit(seen, claim)
        if not frozen.any():
            return
        least = int(seen.same[frozen].min())
        # A stop that lets go changes each torque so slowly that all are the same for some ticks by
        # chance: only what moves meanwhile counts, not since one of them has been the same.
        share = 1.0 if controlled else least / seen.same[frozen]
        felt = controlled and (seen.swing > settings.frozen_tension)[frozen].any()
        if felt or (seen.jolt[frozen] * share > settings.frozen_rate).any():
            yield Violation(Requirement.FROZEN, NOWHERE, least)

    def _at_its_limit(self, seen: Observation, claim: Claim) -> NDArray[np.bool_]:
        """Torques that cannot follow a motion any further: the motor's limit, as long as it takes
        the tension to its reference or brakes the drum."""
        pull, error = seen.torque - seen.tension, claim.reference[seen.axes] - seen.tension
        right = ((pull > 0.0) == (error > 0.0)) | (seen.torque * seen.rate < 0.0)
        found: NDArray[np.bool_] = seen.limited & right
        return found

    def _controlled(self, seen: Observation, speeds: tuple[float, ...]) -> Iterator[Violation]:
        """In states whose control is to keep the envelope: SUP-4, 6 to 8 and 11."""
        claim, settings, enabled = seen.claim, self._settings, seen.enabled
        if claim is None or claim.state not in CONTROLLED:
            return
        left = abs(seen.unexplained) - settings.unexplained_share * abs(seen.mean_torque)
        yield from _at(Requirement.UNEXPLAINED, seen, left, settings.unexplained_force, enabled)
        yield from _at(Requirement.TENSION, seen, seen.tension, self._most_tension)
        if abs(seen.contact) > self._most_contact:
            yield Violation(Requirement.CONTACT, NOWHERE, seen.contact)
        oldest = max(settings.stale_ms, settings.patience_ms)
        for age in (seen.measured_age, seen.cell_age):
            yield from _at(Requirement.STALE, seen, age, oldest, enabled)
        if seen.contact_age > oldest:
            yield Violation(Requirement.STALE, NOWHERE, seen.contact_age)
        yield from _faster(speeds, (self._most_speed, settings.rotation))
        # What it does not know is not a number; what the daemon does not know is wrong.
        off = abs(claim.tension[seen.axes] - seen.tension)
        off[~np.isfinite(claim.tension[seen.axes])] = np.inf
        limit = settings.logged_tension
        yield from _at(Requirement.MEASURED_LOGGED, seen, off, limit, enabled)
        if not math.isnan(seen.contact) and not abs(claim.contact - seen.contact) <= limit:
            yield Violation(Requirement.MEASURED_LOGGED, NOWHERE, claim.contact - seen.contact)

    def _against(self, seen: Observation) -> Iterator[tuple[Violation, int]]:
        """SUP-5, wherever tensions follow the references, so in a stop along the path too: a torque
        against them; a smaller one that lasts, such as one that is missing; one that is far beyond
        them; and, whatever the torque, a tension that stays away. Where a tension goes against the
        torque it is the platform that moves, and its drum has to follow it. Where a drum turns the
        way that its tension has to go, so much of the torque as would not stop it in ``opposed_ms``
        brakes it, as a platform that is thrown wants; and a tension that is at its reference in
        that time, as fast as it moves, needs no torque that takes it there. What lasts is judged by
        the torque that acts; what is larger by whichever was sent since the look before, since a
        look sees the newest in every second tick."""
        claim, settings = seen.claim, self._settings
        before = seen.tension if self._tension is None else self._tension
        since_ns = seen.now_ns - self._felt_ns
        self._tension, self._felt_ns = seen.tension, seen.now_ns
        if claim is None:
            return
        on_path, stiff = _is_on_path(claim), claim.state in _STIFF
        if not (on_path or claim.state in CONTROLLED):
            return
        reference = claim.reference[seen.axes]
        error = reference - seen.tension
        braking = np.fmax(0.0, np.sign(error) * seen.momentum) / (self._opposed_ns * 1e-9)
        pulls = seen.torques - seen.tension
        drawn = ((pulls > 0.0) != (error > 0.0)) & (abs(error) > settings.opposed_error)
        led = np.where(pulls > 0.0, seen.tension < before, seen.tension > before)
        wrong = drawn & ~led & (abs(pulls) - braking > settings.opposed_force)
        least = self._least_tension if stiff else 0.0
        opposed = wrong.any(axis=0) | ~((reference >= least) & (reference <= self._most_tension))
        far = abs(seen.torques - reference) > settings.excess_force
        excess = seen.enabled & (far & ~drawn).any(axis=0)
        pull = seen.torque - seen.tension
        for each in _at(Requirement.OPPOSED, seen, pull, None, seen.enabled & opposed):
            yield each, self._patience_ns[Requirement.OPPOSED]
        # A stop of a platform that is thrown begins with as much, for some ms.
        longest_ns = self._opposed_ns if on_path else self._patience_ns[Requirement.OPPOSED]
        for each in _at(Requirement.OPPOSED, seen, pull, None, excess):
            yield each, longest_ns
        if on_path or stiff:
            opposed = seen.enabled & ((pull > 0.0) != (error > 0.0))
            opposed &= abs(pull) - braking > settings.opposed_long_force
            opposed &= abs(error) > settings.opposed_long_error
            with np.errstate(invalid="ignore"):
                closer = np.sign(error) * (seen.tension - before)
            opposed &= closer * self._opposed_ns < abs(error) * since_ns
            for each in _at(Requirement.OPPOSED, seen, pull, None, opposed):
                yield each, self._opposed_ns
        if stiff:
            for each in _at(Requirement.OPPOSED, seen, abs(error), self._astray, seen.enabled):
                yield each, self._astray_ns

    def _recorded(self, seen: Observation) -> Iterator[tuple[Violation, int]]:
        """SUP-11 of lengths; and SUP-12 the other way round: a drive without power, or in quick
        stop. In a stop along the path only of a cable that is not given up, as long as it is asked
        for tension: at its end none is."""
        claim, limit = seen.claim, self._settings.logged_length
        if claim is None:
            return
        if claim.state in CONTROLLED:
            for each in _at(Requirement.MEASURED_LOGGED, seen, seen.off_bus, limit, seen.enabled):
                yield each, self._period_ns
        asked = np.ones(len(claim.failed), bool)
        if _is_on_path(claim):
            asked = ~claim.failed & (claim.reference > 0.0)
        elif claim.state not in CONTROLLED[1:]:
            return
        off = asked[seen.axes] & (seen.useless | ~seen.enabled)
        reference = claim.reference[seen.axes]
        for each in _at(Requirement.DISARMED, seen, reference, None, off & seen.beating):
            yield each, self._unpowered_ns
        # Drives of a channel without a heartbeat go on for a while, and only then the daemon can
        # know of it: its own stop has the others.
        for each in _at(Requirement.DISARMED, seen, reference, None, off):
            yield each, self._unpowered_ns + self._timeout_ns

    def _stopping(self, seen: Observation) -> Iterator[Violation]:
        """In SAFE_STOP, besides what holds in every state: SUP-7 and 26."""
        settings, claim = self._settings, seen.claim
        if claim is None or claim.state != State.SAFE_STOP:
            return
        if not seen.contact_defective and abs(seen.contact) > settings.contact_at_once:
            yield Violation(Requirement.CONTACT, NOWHERE, seen.contact)
        if claim.stop_mode == StopMode.PASSIVE:
            # Each drum has a share of the passive tension, and a damping against its motion.
            reeling_in, paying_out = seen.torques[1] - self._passive_tension, -seen.torques[0]
            undamped = -self._least_damping * seen.rate - seen.torques[1]
            undamped[claim.failed[seen.axes] | seen.incredible] = -np.inf
            driving = np.where(seen.rate > 0.0, reeling_in, np.fmax(paying_out, undamped))
            # Which way a drum turns whose drive has not answered for long is not known.
            old = seen.measured_age > settings.patience_ms
            driving = np.where(old, np.fmax(reeling_in, paying_out), driving)
            # A torque that no record has is SUP-10's: it may be one of before the stop, come late.
            turning = seen.enabled & ~seen.unlogged & (old | (abs(seen.rate) > 0.0))
            yield from _at(Requirement.BRAKED, seen, driving, settings.passive_torque, turning)

    def _always(self, seen: Observation, speeds: tuple[float, ...]) -> Iterator[Violation]:
        """Bounds of every state, wide enough for what a torn cable does to a good stop. While the
        daemon stops, a contact cell whose amplifier reports an error, and which shows more than a
        person bears, is broken."""
        settings, claim = self._settings, seen.claim
        stopping = claim is not None and claim.state == State.SAFE_STOP
        broken = seen.contact_defective and not abs(seen.contact) <= settings.contact_at_once
        if abs(seen.contact) > settings.contact_stopping and not (stopping and broken):
            yield Violation(Requirement.CONTACT, NOWHERE, seen.contact)
        yield from _faster(speeds, (settings.speed_stopping, settings.rotation_stopping))


def _is_on_path(claim: Claim) -> bool:
    return claim.state == State.SAFE_STOP and claim.stop_mode == StopMode.ON_PATH


def _faster(speeds: tuple[float, ...], limits: tuple[float, ...]) -> Iterator[Violation]:
    for speed, limit in zip(speeds, limits, strict=True):
        if speed > limit:
            yield Violation(Requirement.SPEED, NOWHERE, speed)


def _at(
    requirement: Requirement,
    seen: Observation,
    values: Floats,
    limit: float | None,
    where: NDArray[np.bool_] | bool = True,
) -> Iterator[Violation]:
    """Each axis of ``where`` whose value is beyond the limit; None: each of them."""
    beyond = where if limit is None else where & (values > limit)
    for row in np.asarray(beyond).nonzero()[0].tolist():
        yield Violation(requirement, int(seen.axes[row]), float(values[row]))
