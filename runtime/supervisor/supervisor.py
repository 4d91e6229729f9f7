"""Look, judge, and send the heartbeat or be silent."""

from __future__ import annotations

import contextlib
import math
import struct
from collections.abc import Callable

import can
import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.root import Config
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.states import ARMED, Operator, State
from tonus.runtime.supervisor.commands import NMT, REQUEST, Commands, Own, Told, told_by
from tonus.runtime.supervisor.heartbeat import Beats
from tonus.runtime.supervisor.judge import NOWHERE, Judge, Violation
from tonus.runtime.supervisor.listener import Heard, Listener, Watched
from tonus.runtime.supervisor.observation import Listened, Observation, Observer, age
from tonus.runtime.supervisor.record import CONTROLLED, Claim, Records, claims
from tonus.runtime.supervisor.recorded import RecordedWiring, Replayed
from tonus.runtime.supervisor.wiring import Value, Wiring

OpenBus = Callable[[str, str, int], can.BusABC]
"""From interface, channel and bit rate."""
_EMERGENCY, _RPDO, _HEARTBEAT = 0x080, 0x200, 0x700
_HELD, _RELEASED = b"\1", b"\0"
"""digital outputs of the relay's node: bit 0 is the coil"""
_OPERATIONAL = b"\5"
_STATE, _BOOT_UP = Value(0, 8), 0
"""of a heartbeat"""
_ERROR = struct.Struct("<HBBf")
_EMERGENCY_BYTES = 8
"""Error code, error register, axis or 0xFF, value; CiA 301 leaves the last five to the device."""
_ERROR_CODE, _REGISTER, _NO_AXIS = 0xFF00, 0x81, 0xFF
_LARGEST = 3.4e38
"""below the largest float of 32 bits"""


class Supervisor:
    """Call `step` every ``supervisor.period_ms``.

    It is silent at first, and after a violation; the heartbeat begins when no drive has been
    enabled for ``quiet_s`` and everything arrives that it judges by, after a violation not before
    the operator's reset is recorded, or a daemon that has begun anew. So its restart, or a mistake
    of its own that has passed, gives an armed robot nothing back. A silent drive counts as what it
    was, while the daemon's record is armed or the drive sends heartbeats and has not booted since.
    A channel on which no device answers, or torques come late, gets no heartbeat any more.

    With a relay in the circuit of the STO inputs it judges what the daemon records of the drives,
    and the heartbeat and the relay's output are what it holds.
    """

    def __init__(
        self,
        config: Config,
        records: Records,
        open_bus: OpenBus,
        clock: Callable[[], int] | None = None,
    ) -> None:
        """``clock``: ns, as `step` is told them; None where no time passes within a step. Raises
        `can.CanError` and OSError when a channel cannot be opened, and ValueError for a
        configuration without a supervisor."""
        settings, relay = config.supervisor, config.relay
        if settings is None or settings.policy == "off":
            raise ValueError("the configuration has no supervisor")
        self.settings = settings
        self.violation: Violation | None = None
        """what it stopped the robot for; None while it sends its heartbeat"""
        recorded = None if relay is None else RecordedWiring(config, relay)
        wiring = recorded or Wiring(config)
        self._axes = wiring.axes
        self._replayed = None if recorded is None else Replayed(config, recorded)
        """what the daemon records, where the drives' frames are not read"""
        self._holds = False
        """whether it has set the relay's output"""
        self._records, self._clock = records, clock
        self._tick_ns = config.control.rates.period_ns
        self._observe = Observer(wiring, settings, config.robot.contact_cell, self._tick_ns)
        self._judge = Judge(config, settings)
        self._quiet_ns: int | None = None
        """since when no drive is enabled"""
        self._looked_ns = 0
        self._tick = -1
        self._recorded_ns = -self._tick_ns
        """of the newest record: its tick, and when that was due"""
        self._booted = np.zeros(len(self._axes), bool)
        """drives that have booted since their last measurement, and were told no power since"""
        self._led = np.zeros(len(self._axes), bool)
        """drives that were told beside their process data to have power, until they answer that
        they are off"""
        self._led_before = self._led.copy()
        """which were so in the look before"""
        self._recorded = self._paused = False
        """there was a record before this look, not of FAULT; and none for ``quiet_s``"""
        self._changed: Violation | None = None
        """since then, until the next record"""
        self._unreset = False
        """it stopped the robot, and no reset was recorded since, nor the beginning of a daemon"""
        self._restarted = self._forgetful = False
        """a device has booted since the last record of FAULT; and STANDBY was recorded then"""
        self._foul: Violation | None = None
        """others commanded devices, or wrote to them, and FAULT, in which a daemon brings them up
        again, was not recorded since"""
        self._told_ns = 0
        """when that was told last"""
        self._unbooted: set[tuple[str, int]] = set()
        """heartbeats of devices that have not booted since"""
        self._agreed_ns = 0
        """when record and statuswords agreed last whether the robot is controlled"""
        self._listeners: list[Listener] = []
        own = _HEARTBEAT + settings.node_id
        for interface, channel, bitrate in wiring.channels:
            bus = open_bus(interface, channel, bitrate)
            watched = _watched(wiring, channel) if relay is None else _watched_of(relay.node_id)
            self._listeners.append(Listener(bus, [*watched, Watched(own, 0, (), command=True)]))
        names = [name for _, name, _ in wiring.channels]
        frames = {
            (name, identifier): heard
            for name, listener in zip(names, self._listeners, strict=True)
            for identifier, heard in listener.heard.items()
        }
        self._heard: Listened = frames if self._replayed is None else self._replayed.heard
        self._beating = [False] * len(names)
        """on each channel"""
        timeout_ms = settings.timeout_ms if relay is None else relay.timeout_ms
        self._timeout_ns = timeout_ms * 1_000_000
        """how long drives, or the relay's node, wait for its heartbeat"""
        self._beats = [
            Beats(own, frames[name, own], settings.period_ms, timeout_ms) for name in names
        ]
        self._beat_ns = [0] * len(names)
        """when each was sent a heartbeat last"""
        self._unwatched_ns: list[int | None] = [None] * len(names)
        """since when drives of each have power without a heartbeat, or since the last single one"""
        self._channel_of = np.zeros(len(wiring.axes), np.int64)
        self._output: Own | None = None
        """what the relay's node is told"""
        self._own: list[Own] = [*self._beats]
        if relay is None:
            self._channel_of[:] = [names.index(axis.channel) for axis in wiring.axes]
            self._answers = [_answers(wiring, name, frames) for name in names]
            """of the drives of each channel, and of all of its devices"""
            amplifiers = {(NOWHERE, cell.channel, cell.request) for cell in wiring.cells}
            devices = [(axis.number, axis.channel, axis.request) for axis in wiring.axes]
            devices = [*sorted(amplifiers), *devices]
        else:
            output = _RPDO + relay.node_id
            self._output = Own(output, frames[relay.channel, output])
            self._own.append(self._output)
            self._answers = [([frames[relay.channel, _HEARTBEAT + relay.node_id]],) * 2]
            devices = [(NOWHERE, relay.channel, REQUEST + relay.node_id)]
        told = [
            Told(where, request - REQUEST, frames[name, request], frames[name, NMT])
            for where, name, request in devices
        ]
        self._commands = Commands(told, self._own)
        self._errors = {
            (cell.channel, cell.heartbeat): frames[cell.channel, cell.emergency]
            for cell in wiring.cells
            if cell.heartbeat
        }
        """emergency frames of each amplifier, by its heartbeat"""
        beaten = {*self._errors, *((axis.channel, axis.heartbeat) for axis in wiring.axes)}
        if relay is not None:
            beaten = {(relay.channel, _HEARTBEAT + relay.node_id)}
        self._devices = {key: frames[key] for key in sorted(beaten)}
        """heartbeats of each"""
        self._boots: set[tuple[str, int]] = set()
        """those with which a device has booted since the look before"""

    def step(self, now_ns: int) -> None:
        """Never raises for a bus: what cannot be received ages, what cannot be sent is missed."""
        for listener in self._listeners:
            with contextlib.suppress(can.CanError, OSError):
                listener.read(now_ns)
        self._note_boots()
        commanded = self._commands()
        seen = self._look(now_ns)
        # A drive that is silent is what it was, unless daemon and all others are disarmed and it
        # sends no heartbeat either: then it was pulled, or has no power.
        present = seen.measured_age < self.settings.stale_ms
        state = None if seen.claim is None else seen.claim.state
        seen.enabled &= present | self._alive(seen) | (not present.any()) | (state in ARMED)
        if state not in ARMED:
            seen.enabled &= ~self._booted
            self._led &= ~self._booted
        # Nobody in order tells a drive to have power that was pulled.
        seen.enabled |= seen.told
        led = np.isin(seen.axes, self._commands.led)
        led |= seen.told
        self._booted &= ~led
        self._led |= led
        # What is answered in that look, or in the next one, may be of before it acted.
        unanswered = seen.measured_age * 1e6 >= now_ns - self._looked_ns
        self._led &= seen.enabled | unanswered | led | self._led_before
        self._led_before = led
        armed = bool(seen.enabled.any())
        self._judge.note(seen.claims)
        if armed:
            self._quiet_ns = None
        else:
            self._judge.rest(now_ns)
            stalled = now_ns - self._looked_ns > self._timeout_ns
            if stalled:
                # Drives, or the relay, have lost the heartbeat: as after a start of its own.
                self._beating = [False] * len(self._listeners)
            if stalled or self._quiet_ns is None:
                self._quiet_ns = now_ns
        # Drives take their time to be enabled, and are sent no torque meanwhile.
        enabling = state == State.REFERENCING and not seen.mille.any()
        if armed or enabling or state not in CONTROLLED:
            self._agreed_ns = now_ns
        self._fall_silent_where_deaf(now_ns, armed)
        silent = bool(seen.measured_age.min() > self.settings.quiet_s * 1e3)
        if (silent or not armed) and not self._sees(seen):
            self._beating = [False] * len(self._listeners)
        quiet = self._quiet_ns is not None and (
            now_ns - self._quiet_ns >= self.settings.quiet_s * 1e9
        )
        if quiet:
            self._judge.forget()
        changed = self._changed_beside(seen)
        stopped = self._foul or self._unbooted or self._unreset
        begins = quiet and not (stopped or all(self._beating))
        if begins and self._hears(seen) and self._sees(seen):
            self._beating = [True] * len(self._listeners)
            self._beat_ns = [now_ns] * len(self._listeners)
            for own in self._own:
                own.begin()
            self.violation = None
        if self.settings.policy == "require":
            self._begin_watches(now_ns, seen, quiet)
        # The drives of a channel without a heartbeat stop by themselves; the others are judged.
        seen.beating = np.array(self._beating)[self._channel_of]
        seen.enabled &= seen.beating
        if seen.enabled.any() or self._commands.led or changed:
            found = changed or commanded or self._late(now_ns) or self._judge(seen)
            if found is not None and found.alone:
                self._beating[self._channel_of[seen.axes == found.where].item()] = False
            elif found is not None:
                self._fall_silent(found)
        self._tell_again(now_ns)
        self._beat(now_ns)
        self._hold_relay()
        self._looked_ns = now_ns

    def _look(self, now_ns: int) -> Observation:
        found = self._risen(now_ns, claims(self._records(), answered=self._replayed is not None))
        if self._replayed is None:
            return self._observe(now_ns, self._heard, found)
        self._replayed.take(found)
        seen = self._observe(now_ns, self._heard, found)
        # What a drive was sent is the record itself: its own figure is what there is to compare.
        seen.unlogged = self._replayed.astray > self.settings.answered_torque
        seen.pulled |= seen.unlogged
        return seen

    def _risen(self, now_ns: int, found: list[Claim]) -> list[Claim]:
        """Without those of the future, and those of no later tick, or time, than the one before:
        whoever writes the same again has recorded nothing. More than two in a tick's time are none
        of a daemon, and would make what is compared with them as many."""
        latest_ns, least_ns = now_ns + self._tick_ns, self._tick_ns // 2
        risen: list[Claim] = []
        for claim in found:
            later = self._recorded_ns + least_ns < claim.at_ns <= latest_ns
            if claim.tick > self._tick and later:
                self._tick, self._recorded_ns = claim.tick, claim.at_ns
                risen.append(claim)
        return risen

    def _alive(self, seen: Observation) -> NDArray[np.bool_]:
        """Drives that go on sending heartbeats after their last measurement, and have not booted
        since: whether they still have a torque nothing says."""
        found = np.zeros(len(self._axes), bool)
        for row, axis in enumerate(self._axes):
            if not axis.heartbeat:
                continue
            beats = self._heard[axis.channel, axis.heartbeat]
            self._booted[row] |= (axis.channel, axis.heartbeat) in self._boots
            later_ms = seen.measured_age[row] - (seen.now_ns - beats.at_ns) * 1e-6
            found[row] = later_ms >= self.settings.stale_ms
        self._booted &= seen.measured_age > 0.0
        return found & ~self._booted

    def _note_boots(self) -> None:
        """An amplifier that boots takes nothing back, and has the errors that it reports anew."""
        self._boots = {key for key, beats in self._devices.items() if _BOOT_UP in beats.numbers}
        for beats in self._devices.values():
            beats.numbers.clear()
        for key in self._boots & self._errors.keys():
            self._errors[key].word = 0
        self._unbooted -= self._boots

    def _hold_relay(self) -> None:
        """Its output is on as long as the heartbeat goes, and is off at once with its end."""
        if self._output is None or not (self.beating or self._holds):
            return
        told = self._tell(0, self._output, _HELD if self.beating else _RELEASED)
        self._holds = self.beating or not told

    def _fall_silent(self, found: Violation) -> None:
        """On every channel. What others have done is told where no heartbeat goes too: the daemon
        has to bring the devices up again, each of them from its boot-up on."""
        self.violation, self._quiet_ns, self._unreset = found, None, True
        first = found.requirement is Requirement.COMMANDED and not self._foul
        if first:
            self._foul, self._told_ns, self._unbooted = found, self._looked_ns, {*self._devices}
        for place, beating in enumerate(self._beating):
            if beating or first:
                self._send(place, _EMERGENCY + self.settings.node_id, _error(found))
        self._beating = [False] * len(self._listeners)

    def _tell_again(self, now_ns: int) -> None:
        """What others have done, each ``quiet_s``: a frame may be lost."""
        if self._foul and now_ns - self._told_ns >= self.settings.quiet_s * 1e9:
            self._told_ns = now_ns
            for place in range(len(self._listeners)):
                self._send(place, _EMERGENCY + self.settings.node_id, _error(self._foul))

    def _changed_beside(self, seen: Observation) -> Violation | None:
        """A download, or a command of the network, between records that are not of FAULT, in which
        alone a daemon makes some: the device is no longer what the bring-up has made of it. However
        long the record pauses, it counts once that goes on. A daemon that ends makes some too, and
        the next one's record begins with OFF."""
        newest, claims = seen.claim, seen.claims
        recovered = any(claim.state == State.FAULT for claim in claims)
        begun = bool(claims) and self._paused and claims[0].state == State.OFF
        recovered |= begun
        if recovered:
            self._foul = None
        if begun or any(claim.operator == Operator.RESET for claim in claims):
            self._unreset = False
        self._note_restarts(claims, recovered=recovered)
        found = self._changed if claims and not (recovered or self._foul) else None
        if claims:
            self._changed = None
        if self._recorded:
            self._changed = self._changed or self._commands.changed
        self._recorded = newest is not None and newest.state != State.FAULT
        quiet_ns = self.settings.quiet_s * 1e9
        self._paused = newest is not None and seen.now_ns - newest.at_ns > quiet_ns
        return found

    def _note_restarts(self, claims: list[Claim], *, recovered: bool) -> None:
        """A device that restarts has lost what the bring-up made of it. The daemon answers with
        FAULT, if only after a stop; one that is armed again without that counts as changed."""
        if self._recorded and self._replayed is None:
            self._restarted |= bool(self._boots)
        if recovered:
            self._restarted = self._forgetful = False
        for claim in claims:
            self._forgetful |= self._restarted and claim.state == State.STANDBY
            if self._forgetful and claim.state in CONTROLLED:
                self._changed = self._changed or Violation(Requirement.COMMANDED, NOWHERE, 0.0)

    def _begin_watches(self, now_ns: int, seen: Observation, quiet: bool) -> None:
        """Drives that keep power although they get no heartbeat, or were told to beside their
        process data, have heard none since they were started, or reset: a single one begins their
        watch (CiA 301). The next one comes when that is over, so that no drive is held, and later
        where the last one waits still, or was lost. Pauses of the power count with it, until no
        drive has been enabled for ``quiet_s``."""
        for place, beating in enumerate(self._beating):
            since_ns = self._unwatched_ns[place]
            powered = (seen.enabled | self._led) & (self._channel_of == place)
            if beating or (quiet and not powered.any()):
                self._unwatched_ns[place] = None
            elif not powered.any():
                continue
            elif since_ns is None or self._beats[place].heard.at_ns > since_ns:
                self._unwatched_ns[place] = now_ns
            else:
                beats = self._beats[place]
                # Farther apart than drives or a relay need: closer ones would be what holds them.
                longest_ns = max(self._timeout_ns, self.settings.timeout_ms * 1e6)
                due_ns = (8.0 if beats.waits else 2.0) * longest_ns
                if now_ns - since_ns < due_ns:
                    continue
                beats.give_up()
                if self._tell(place, beats, _OPERATIONAL):
                    self._unwatched_ns[place] = now_ns

    def _late(self, now_ns: int) -> Violation | None:
        """Looks that come late keep the drives alive, and find everything late. Where they are
        later than whoever watches waits, it is lost already."""
        settings = self.settings
        since_ms = (now_ns - self._looked_ns) * 1e-6
        most_ms = 2 * settings.period_ms + settings.patience_ms
        if since_ms <= min(most_ms, self._timeout_ns * 1e-6):
            return None
        return Violation(Requirement.LATE, NOWHERE, since_ms)

    @property
    def beating(self) -> bool:
        """Whether any channel gets a heartbeat."""
        return any(self._beating)

    def _sees(self, seen: Observation) -> bool:
        """Whether it would see that a drive is enabled: without frames, only by a record that goes
        on, in which some drive answers, and which is not of a controlled robot without drives."""
        if self._replayed is None:
            return True
        settings = self.settings
        return (
            seen.claim is not None
            and seen.now_ns - seen.claim.at_ns <= settings.patience_ms * 1e6
            and bool(seen.measured_age.min() <= settings.quiet_s * 1e3)
            and seen.now_ns - self._agreed_ns <= settings.disarmed_ms * 1e6
        )

    def _hears(self, seen: Observation) -> bool:
        """Whether everything arrives that it judges by: it does not begin deaf."""
        ages = [*seen.measured_age, *seen.torque_age, *seen.cell_age, seen.contact_age]
        ages += [age(seen.now_ns, each) for _, devices in self._answers for each in devices]
        return bool(max(ages) < self.settings.stale_ms)

    def _fall_silent_where_deaf(self, now_ns: int, armed: bool) -> None:
        """While nothing is enabled the daemon may begin anew, which takes no answers; while a drive
        is, its answers alone count, and that no channel answers is SUP-14 to judge."""
        newest_ns = [
            max((each.at_ns for each in (drives if armed else devices)), default=now_ns)
            for drives, devices in self._answers
        ]
        end_ns, longest_ms = now_ns, self.settings.quiet_s * 1e3
        if armed:
            # A look before SUP-14 would stop the drives of the other channels too.
            end_ns = max(newest_ns)
            longest_ms = self.settings.stale_ms - self.settings.period_ms
        for place, answered_ns in enumerate(newest_ns):
            self._beating[place] &= end_ns - answered_ns <= longest_ms * 1e6

    def close(self) -> None:
        """Its heartbeat ends with it."""
        for listener in self._listeners:
            listener.bus.shutdown()

    def _beat(self, now_ns: int) -> None:
        """Where none goes out for so long that drives have lost it, none follows before everything
        has been quiet again. Once a look has lost its processor none is sent: what it saw is too
        old."""
        for place in np.flatnonzero(self._beating).tolist():
            spent_ns = 0 if self._clock is None else self._clock() - now_ns
            beats = self._beats[place]
            in_time = spent_ns <= self.settings.period_ms * 1e6
            if in_time and beats.follows() and self._tell(place, beats, _OPERATIONAL):
                self._beat_ns[place] = now_ns
            if now_ns - self._beat_ns[place] > self._timeout_ns:
                self._beating[place], self._quiet_ns = False, None

    def _tell(self, place: int, own: Own, data: bytes) -> bool:
        """Send what only the supervisor sends."""
        taken = self._send(place, own.identifier, data)
        if taken:
            own.send()
        return taken

    def _send(self, place: int, identifier: int, data: bytes) -> bool:
        """Whether the interface of that channel has taken it."""
        message = can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
        try:
            self._listeners[place].bus.send(message)
        except (can.CanError, OSError):
            return False
        return True


def _error(violation: Violation) -> bytes:
    place = _NO_AXIS if violation.where == NOWHERE else violation.where
    value = violation.value
    if not abs(value) < _LARGEST:
        value = math.copysign(math.inf, value)
    return _ERROR.pack(_ERROR_CODE + violation.requirement, _REGISTER, place, value)


def _answers(wiring: Wiring, channel: str, heard: Listened) -> tuple[list[Heard], list[Heard]]:
    """Of the drives of a channel, and of all of its devices."""
    drives = [heard[channel, axis.received] for axis in wiring.axes if axis.channel == channel]
    cells = [heard[channel, cell.received] for cell in wiring.cells if cell.channel == channel]
    return drives, drives + cells


def _watched_of(node: int) -> list[Watched]:
    """Every identifier that tells of a relay's node."""
    output = Watched(_RPDO + node, 1, (), command=True)
    return [Watched(_HEARTBEAT + node, 1, (_STATE,)), output, *told_by([node])]


def _watched(wiring: Wiring, channel: str) -> list[Watched]:
    """Every identifier of a channel that tells of an axis or a cell."""
    axes = [axis for axis in wiring.axes if axis.channel == channel]
    cells = [cell for cell in wiring.cells if cell.channel == channel]
    requests = {axis.request for axis in axes} | {cell.request for cell in cells}
    found = told_by(sorted(request - REQUEST for request in requests))
    for axis in axes:
        values = (axis.torque,)
        told = Watched(axis.sent, axis.sent_bytes, values, command=True, sync=axis.sync)
        found.append(told._replace(controlword=axis.controlword))
        found.append(Watched(axis.received, axis.received_bytes, (), axis.statusword))
        found.append(Watched(axis.heartbeat, 1, (_STATE,)))
    forces: dict[int, tuple[int, list[Value]]] = {}
    for cell in cells:
        forces.setdefault(cell.received, (cell.received_bytes, []))[1].append(cell.force)
    found += [Watched(key, size, tuple(values)) for key, (size, values) in forces.items()]
    for emergency, heartbeat in sorted({(cell.emergency, cell.heartbeat) for cell in cells}):
        found.append(Watched(emergency, _EMERGENCY_BYTES, (), errors=True))
        found.append(Watched(heartbeat, 1, (_STATE,)))
    return found
