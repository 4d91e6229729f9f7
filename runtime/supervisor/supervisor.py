"""Look, judge, and send the heartbeat or be silent."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import can
import numpy as np

from tonus.config.schema.root import Config
from tonus.config.schema.supervisor import Requirement
from tonus.runtime.states import State
from tonus.runtime.supervisor.changes import Changes
from tonus.runtime.supervisor.commands import NMT, REQUEST, Commands, Told
from tonus.runtime.supervisor.devices import Boots, Powered
from tonus.runtime.supervisor.judge import NOWHERE, Judge, Violation
from tonus.runtime.supervisor.listener import Listener, Watched
from tonus.runtime.supervisor.observation import Listened, Observation, Observer, age
from tonus.runtime.supervisor.record import CONTROLLED, Claim, Records, claims
from tonus.runtime.supervisor.recorded import RecordedWiring, Replayed
from tonus.runtime.supervisor.voice import Voice
from tonus.runtime.supervisor.watched import (
    HEARTBEAT,
    answers,
    watched_of_amplifiers,
    watched_of_relay,
    watched_on,
)
from tonus.runtime.supervisor.wiring import Wiring

OpenBus = Callable[[str, str, int], can.BusABC]
"""From interface, channel and bit rate."""


class Supervisor:
    """Call `step` every ``supervisor.period_ms``.

    It is silent at first, and after a violation; the heartbeat begins when no drive has been
    enabled for ``quiet_s`` and everything arrives that it judges by, after a violation not before
    the operator's reset is recorded. So its restart, or a mistake of its own that has passed, gives
    an armed robot nothing back. A channel on which no device answers, or torques come late, gets no
    heartbeat any more.

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
        self._replayed = None if recorded is None else Replayed(config, recorded)
        """what the daemon records, where the drives' frames are not read"""
        self._records = records
        self._tick_ns = config.control.rates.period_ns
        self._observe = Observer(wiring, settings, config.robot.contact_cell, self._tick_ns)
        self._judge = Judge(config, settings)
        self._quiet_ns: int | None = None
        """since when no drive is enabled"""
        self._looked_ns = 0
        self._tick = -1
        self._recorded_ns = -self._tick_ns
        """of the newest record: its tick, and when that was due"""
        self._agreed_ns = 0
        """when record and statuswords agreed last whether the robot is controlled"""
        own = Watched(HEARTBEAT + settings.node_id, 0, (), command=True)
        if relay is None:
            watched = {name: [*watched_on(wiring, name), own] for _, name, _ in wiring.channels}
        else:
            watched = {relay.channel: [*watched_of_relay(relay.node_id), own]}
        # Beside drives on EtherCAT amplifiers may be on CAN, where others can write to them too.
        beside = wiring if relay is None else Wiring(config)
        channels = {name: (interface, bitrate) for interface, name, bitrate in wiring.channels}
        for interface, name, bitrate in () if relay is None else beside.channels:
            watched.setdefault(name, []).extend(watched_of_amplifiers(beside, name))
            channels.setdefault(name, (interface, bitrate))
        self._listeners = [
            Listener(open_bus(interface, name, bitrate), watched[name])
            for name, (interface, bitrate) in channels.items()
        ]
        frames = {
            (name, identifier): heard
            for name, listener in zip(channels, self._listeners, strict=True)
            for identifier, heard in listener.heard.items()
        }
        self._heard: Listened = frames if self._replayed is None else self._replayed.heard
        names = [name for _, name, _ in wiring.channels]
        buses = [(name, each.bus) for name, each in zip(names, self._listeners, strict=False)]
        self._voice = Voice(settings, relay, buses, frames, clock)
        self._channel_of = np.zeros(len(wiring.axes), np.int64)
        cells = beside.cells
        amplifiers = {(NOWHERE, cell.channel, cell.request) for cell in cells}
        beats = {(cell.channel, cell.heartbeat) for cell in cells}
        devices = sorted(amplifiers)
        if relay is None:
            self._channel_of[:] = [names.index(axis.channel) for axis in wiring.axes]
            self._answers = [answers(wiring, name, frames) for name in names]
            """of the drives of each channel, and of all of its devices"""
            devices += [(axis.number, axis.channel, axis.request) for axis in wiring.axes]
            beats |= {(axis.channel, axis.heartbeat) for axis in wiring.axes}
        else:
            node = (relay.channel, HEARTBEAT + relay.node_id)
            self._answers = [([frames[node]],) * 2]
            devices.append((NOWHERE, relay.channel, REQUEST + relay.node_id))
            beats.add(node)
        started = None if relay is None else devices[-1]
        told = [
            Told(
                where, request - REQUEST, frames[name, request], frames[name, NMT],
                (where, name, request) == started,
            )
            for where, name, request in devices
        ]  # fmt: skip
        self._commands = Commands(told, self._voice.own)
        errors = {
            (cell.channel, cell.heartbeat): frames[cell.channel, cell.emergency]
            for cell in cells
            if relay is None
        }
        self._boots = Boots({key: frames[key] for key in sorted(beats)}, errors)
        self._changes = Changes(self._boots, settings.quiet_s)
        self._powered = Powered(wiring.axes, self._heard, self._boots, settings.stale_ms)

    def step(self, now_ns: int) -> None:
        """Never raises for a bus: what cannot be received ages, what cannot be sent is missed."""
        for listener in self._listeners:
            with contextlib.suppress(can.CanError, OSError):
                listener.read(now_ns)
        self._boots.note()
        commanded = self._commands()
        seen = self._look(now_ns)
        self._powered.settle(seen, self._commands.led, self._looked_ns)
        self._judge.note(seen.claims)
        quiet = self._is_quiet(seen)
        changed = self._changes(seen, self._commands.changed)
        begins = quiet and not (self._changes.awaited or all(self._voice.beating))
        if begins and self._hears(seen) and self._sees(seen):
            self._voice.begin(now_ns)
            self.violation = None
        if self.settings.policy == "require":
            powered = seen.enabled | self._powered.led
            channels = range(len(self._voice.beating))
            each = [powered[self._channel_of == place].any() for place in channels]
            self._voice.begin_watches(now_ns, each, quiet=quiet)
        # The drives of a channel without a heartbeat stop by themselves; the others are judged.
        seen.beating = np.array(self._voice.beating)[self._channel_of]
        seen.enabled &= seen.beating
        if seen.enabled.any() or self._commands.led or changed:
            found = changed or commanded or self._late(now_ns) or self._judge(seen)
            if found is not None and found.alone and sum(self._voice.beating) > 1:
                self._voice.beating[self._channel_of[seen.axes == found.where].item()] = False
            elif found is not None:
                self._fall_silent(found)
        again = self._changes.again(now_ns)
        if again is not None:
            self._voice.tell(again)
        if self._voice.beat(now_ns):
            self._quiet_ns = None
            if seen.enabled.any() and not self.beating:
                late = Violation(Requirement.LATE, NOWHERE, self._voice.timeout_ns * 1e-6)
                self._fall_silent(late)
                self._voice.tell(late)
        self._voice.hold_relay(now_ns)
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

    def _is_quiet(self, seen: Observation) -> bool:
        """Whether no drive has been enabled for ``quiet_s``. The heartbeat ends where nothing would
        show that one is."""
        now_ns, armed = seen.now_ns, bool(seen.enabled.any())
        if armed:
            self._quiet_ns = None
        else:
            self._judge.rest(now_ns)
            stalled = now_ns - self._looked_ns > self._voice.timeout_ns
            if stalled:
                # Drives, or the relay, have lost the heartbeat: as after a start of its own.
                self._voice.end()
            if stalled or self._quiet_ns is None:
                self._quiet_ns = now_ns
        # Drives take their time to be enabled, and are sent no torque meanwhile.
        state = None if seen.claim is None else seen.claim.state
        enabling = state == State.REFERENCING and not seen.mille.any()
        if armed or enabling or state not in CONTROLLED:
            self._agreed_ns = now_ns
        before = self.beating
        self._fall_silent_where_deaf(now_ns, armed)
        if armed and before and not self.beating:
            # Drives that get no heartbeat may answer still: that no other channel does is SUP-14.
            deaf = Violation(Requirement.STALE, NOWHERE, float(seen.measured_age.min()))
            self._fall_silent(deaf)
            self._voice.tell(deaf)
        silent = bool(seen.measured_age.min() > self.settings.quiet_s * 1e3)
        if (silent or not armed) and not self._sees(seen):
            self._voice.end()
        quiet = self._quiet_ns is not None and (
            now_ns - self._quiet_ns >= self.settings.quiet_s * 1e9
        )
        if quiet:
            self._judge.forget()
        return quiet

    def _fall_silent(self, found: Violation) -> None:
        """On every channel. What others have done is told where no heartbeat goes too: the daemon
        has to bring the devices up again, each of them from its boot-up on."""
        self.violation, self._quiet_ns = found, None
        everywhere = self._changes.stop(found, self._looked_ns)
        self._voice.fall_silent(found, everywhere=everywhere)

    def _late(self, now_ns: int) -> Violation | None:
        """Looks that come late keep the drives alive, and find everything late. Where they are
        later than whoever watches waits, it is lost already."""
        since_ms = (now_ns - self._looked_ns) * 1e-6
        if since_ms <= min(self.settings.longest_look_ms, self._voice.timeout_ns * 1e-6):
            return None
        return Violation(Requirement.LATE, NOWHERE, since_ms)

    @property
    def beating(self) -> bool:
        """Whether any channel gets a heartbeat."""
        return any(self._voice.beating)

    def _sees(self, seen: Observation) -> bool:
        """Whether it would see that a drive is enabled: without frames, only by a record that goes
        on, in which some drive answers and none has fallen silent with power, and which is not of a
        controlled robot without drives."""
        if self._replayed is None:
            return True
        settings = self.settings
        return (
            seen.claim is not None
            and seen.now_ns - seen.claim.at_ns <= settings.patience_ms * 1e6
            and bool(seen.measured_age.min() <= settings.quiet_s * 1e3)
            and not self._powered.lost.any()
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
        newest_ns = {
            place: max(each.at_ns for each in heard)
            for place, (drives, devices) in enumerate(self._answers)
            if (heard := drives if armed else devices)
        }
        end_ns, longest_ms = now_ns, self.settings.quiet_s * 1e3
        if armed:
            # A look before SUP-14 would stop the drives of the other channels too.
            end_ns = max(newest_ns.values())
            longest_ms = self.settings.stale_ms - self.settings.period_ms
        for place, answered_ns in newest_ns.items():
            self._voice.beating[place] &= end_ns - answered_ns <= longest_ms * 1e6

    def close(self) -> None:
        """Its heartbeat ends with it."""
        for listener in self._listeners:
            listener.bus.shutdown()
