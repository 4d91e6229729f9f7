"""What the supervisor has before it when it judges, in SI units at the cables."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.supervisor import Supervisor
from tonus.runtime.supervisor.lengths import Lengths
from tonus.runtime.supervisor.listener import Heard
from tonus.runtime.supervisor.record import Claim, Floats
from tonus.runtime.supervisor.wiring import Cell, Wiring

_MS = 1e-6
_ROUNDING = 1
"""per mille"""
_TICKS = 1.5
"""by which the time between two answers may differ from what their number says"""
_TRAVEL_LOOKS = 4
"""over which a rate is taken whose SYNCs are irregular"""
_UNANSWERED = 4
"""ticks without an answer: sampled, read, recorded and looked at, each may take one"""
_SETTLED = 2
"""answers after a look, of which one at least is of after each SYNC in it"""
_LONG_AGO = -1 << 62
"""ns"""
_ABSENT = Heard(())
"""of a cell that there is not"""
Listened = Mapping[tuple[str, int], Heard]
"""By channel and identifier."""


@dataclass
class Observation:
    """Arrays have a row for each axis on the bus; not a number: never received, or not known."""

    now_ns: int
    axes: NDArray[np.int64]
    """numbers"""
    enabled: NDArray[np.bool_]
    """powered by any statusword since the last look, or by the newest; or told to be"""
    useless: NDArray[np.bool_]
    """by its answers, whatever it is told: without power since the last look, or in quick stop"""
    told: NDArray[np.bool_]
    """told to be lately, and no answer since says otherwise"""
    measured_age: Floats
    """ms since the drive's last PDO"""
    channel_age: Floats
    """ms since the last PDO of any drive on its channel"""
    torque_age: Floats
    """ms since the last SYNC on which it acted by a PDO to it"""
    same: NDArray[np.int64]
    """of those PDOs in a row that were equal to the one before"""
    mille: NDArray[np.int64]
    """torque on the bus, per mille of rated torque"""
    pulled: NDArray[np.bool_]
    """that torque, or one that was sent since the last look, is not 0"""
    limited: NDArray[np.bool_]
    """that torque is at the motor's limit"""
    torque: Floats
    """N at the cable"""
    torques: Floats
    """the least and the largest of those since the last look (2, n), the one that acts included"""
    rate: Floats
    """m/s, reeling in"""
    travel: Floats
    """m/s, its mean over the last looks where SYNCs are not those of the ticks; elsewhere not a
    number"""
    momentum: Floats
    """N s at the cable, of the drum"""
    tension: Floats
    """N, tared as the daemon says"""
    contact: float
    """N"""
    cell_age: Floats
    """ms since the last PDO of the cable's cell; 0 without one on the bus"""
    contact_age: float
    """the same of the contact cell"""
    defective: NDArray[np.bool_]
    """the cable's amplifier reports an error of its own"""
    contact_defective: bool
    unexplained: Floats
    """N of the torque's mean over the window that neither tension nor motion explain"""
    mean_torque: Floats
    """N, of the same window"""
    motion: Floats
    """N at the cable that the drum's change of motion and its friction take, likewise"""
    most_torque: Floats
    """N, the largest that was sent in that window"""
    incredible: NDArray[np.bool_]
    """its encoder reports a motion, in that window, that no motor can make"""
    swing: Floats
    """N between a cable's least and largest tension since its drive's torque changed last; 0 where
    it is not known"""
    jolt: Floats
    """m/s between a drum's least and largest rate, the same way"""
    claims: list[Claim]
    """new since the last look, in their order"""
    claim: Claim | None
    """the newest"""
    unlogged: NDArray[np.bool_]
    """a torque that the drive was sent is in none of the newest records"""
    late: NDArray[np.bool_]
    """but in one of before, as long as a drive waits for the heartbeat"""
    off_bus: Floats
    """m by which a recorded length is outside of those on the bus lately"""
    beating: NDArray[np.bool_]
    """its channel has the heartbeat"""
    together: NDArray[np.bool_]
    """drives on one channel (n, n)"""


@dataclass
class _Sample:
    """What a window needs, of one look."""

    at_ns: int
    length: Floats
    """m (n,)"""
    places: NDArray[np.int64]
    """of the position in the drive's answers (n,), and"""
    read_ns: NDArray[np.int64]
    """when that was read"""
    sums: Floats
    """of torques and of forces, in their units on the bus and in N (2, n)"""
    counts: NDArray[np.int64]
    """of their frames (2, n)"""
    tension: Floats
    """N (n,)"""
    most: Floats
    """N, the largest torque since the look before (n,)"""
    rate: Floats
    """m/s since the answer before (n,); not a number where answers are missing"""


class Observer:
    """Makes an observation of what was received and recorded."""

    def __init__(
        self, wiring: Wiring, settings: Supervisor, contact_cell: int, tick_ns: int
    ) -> None:
        """A drive answers each SYNC, one every ``tick_ns``."""
        self._axes, self._settings, self._tick_ns = wiring.axes, settings, tick_ns
        self._cell_of = {cell.number: cell for cell in wiring.cells}
        self._contact = self._cell_of.get(contact_cell)
        self._numbers = np.array([axis.number for axis in wiring.axes], np.int64)
        channels = np.array([axis.channel for axis in wiring.axes])
        self._together = channels == channels[:, None]
        self._newton = np.array([np.nan if a.newton is None else a.newton for a in wiring.axes])
        self._limit = np.array([axis.limit for axis in wiring.axes], np.int64)
        self._mass = np.array([axis.mass for axis in wiring.axes])
        self._damping = np.array([axis.damping for axis in wiring.axes])
        self._metre = np.array([np.nan if a.metre is None else a.metre for a in wiring.axes])
        self._per_newton_metre = np.array(
            [np.nan if a.newton is None else a.per_newton_metre for a in wiring.axes]
        )
        self._claim: Claim | None = None
        self._claimed: deque[tuple[int, ...]] = deque()
        """per mille, of each axis, by record"""
        self._new = 0
        self._late = math.ceil(settings.timeout_ms * 1e6 / tick_ns)
        """records before those that are compared"""
        self._sent: list[set[float]] = [set() for _ in wiring.axes]
        """to each axis in the look before, per mille"""
        self._samples: deque[_Sample] = deque()
        self._lengths = Lengths(wiring.axes, settings, tick_ns)
        self._rates = np.zeros(len(wiring.axes))
        """m/s, the last that were known"""
        self._since = _Since(len(wiring.axes))
        self._unread = np.array([axis.controlword is None for axis in wiring.axes], bool)
        """it is not known what the drive is told"""
        self._on = self._told_on = np.zeros(len(wiring.axes), np.int64)
        """frames of each axis in which it had power, or was told to have it"""
        self._told = np.full((2, len(wiring.axes)), _LONG_AGO)
        """when a command acted last that gives power, and how many answers there were by then"""

    def __call__(self, now_ns: int, heard: Listened, claims: list[Claim]) -> Observation:
        if claims:
            torque = np.array([claim.torque for claim in claims])[:, self._numbers]
            scaled = torque * self._per_newton_metre
            scaled[~np.isfinite(scaled)] = 0.0
            wanted = np.rint(scaled).astype(np.int64)
            self._claimed.extend(map(tuple, wanted.tolist()))
            self._claim = claims[-1]
        tared = self._claim.tare if self._claim is not None else None
        sent = [heard[axis.channel, axis.sent] for axis in self._axes]
        received = [heard[axis.channel, axis.received] for axis in self._axes]
        mille = np.array(
            [int(a.torque.number(h.word)) for a, h in zip(self._axes, sent, strict=True)], np.int64
        )
        cells = [self._cell_of.get(axis.number) for axis in self._axes]
        same = np.array([each.same for each in sent], np.int64)
        changed = np.array([each.count for each in sent], np.int64) - same
        enabled = np.array([each.powered for each in received], bool)
        before, self._on = self._on, np.array([each.on for each in received], np.int64)
        enabled |= self._on > before
        useless = ~enabled | [each.in_quick_stop for each in received]
        told, waiting = self._powers(now_ns, sent, received, mille)
        enabled |= told | waiting
        # One that was sent before the newest SYNC acts until the next one, whatever waits for that.
        lately = [[*h.numbers, acts] for h, acts in zip(sent, mille.tolist(), strict=True)]
        torques = np.array([(min(each), max(each)) for each in lately]).T * self._newton
        torques = np.sort(torques, axis=0)
        tension = np.array([_force(cell, heard, tared) for cell in cells])
        self._sample(now_ns, received, sent, cells, heard, tension, torques[1])
        rate, unexplained, mean, motion, incredible = self._moved(tared)
        measured_age = _ages(now_ns, received)
        return Observation(
            now_ns,
            self._numbers,
            enabled,
            useless,
            told,
            measured_age,
            np.where(self._together, measured_age, np.inf).min(axis=1),
            _ages(now_ns, sent),
            same,
            mille,
            np.array([any(each) for each in lately], bool),
            abs(mille) >= self._limit,
            mille * self._newton,
            torques,
            rate,
            self._travel(),
            self._mass * rate,
            tension,
            _force(self._contact, heard, tared),
            np.array([_cell_age(now_ns, cell, heard) for cell in cells]),
            _cell_age(now_ns, self._contact, heard),
            np.array([_defective(cell, heard) for cell in cells], bool),
            _defective(self._contact, heard),
            unexplained,
            mean,
            motion,
            np.max([each.most for each in self._samples], axis=0),
            incredible,
            *self._since.spans(enabled, changed, tension, self._samples[-1].rate),
            claims,
            self._claim,
            *self._compared(sent, mille, len(claims)),
            self._lengths(now_ns, self._samples[-1].length, self._claim),
            np.ones(len(enabled), bool),
            self._together,
        )

    def _powers(
        self, now_ns: int, sent: list[Heard], received: list[Heard], mille: NDArray[np.int64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Drives that were told to have power by whatever acted, until two answers later than that
        look say otherwise: the first may be of before the SYNC on which it acted. And those in a
        state that leads to power which hold such a command. Where it is not known what a drive is
        told, one that answers no more is the first if it is sent a torque, and the second whatever
        it is sent. A drive in fault that answers is not the first."""
        on, answers, at_ns, acted_ns = np.array(
            [(s.on, r.count, r.at_ns, s.at_ns) for s, r in zip(sent, received, strict=True)]
        ).T
        gave = on > self._told_on
        self._told_on = on
        self._told[0, gave], self._told[1, gave] = now_ns, answers[gave]
        lately_ns = now_ns - self._settings.stale_ms * 1e6
        late = at_ns < now_ns - _UNANSWERED * self._tick_ns
        told = (self._told[0] > lately_ns) & (answers < self._told[1] + _SETTLED)
        told = np.where(self._unread, late & (mille != 0) & (acted_ns > lately_ns), told)
        told &= late | [not each.failed for each in received]
        holds = np.where(self._unread, late, [each.enables for each in sent])
        return told, holds & [each.startable for each in received]

    def _compared(
        self, sent: list[Heard], mille: NDArray[np.int64], new: int
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which are unlogged, and which of them late. A tick is recorded after its torques are
        sent: those of the look before are compared, and the one that acts, with the records since
        then and ``logged_ticks`` more."""
        newest = self._settings.logged_ticks + self._new + new
        while len(self._claimed) > self._late + newest:
            self._claimed.popleft()
        known = np.isfinite(self._newton)
        found, late = known.copy(), known
        claimed = list(zip(*self._claimed, strict=True)) or [()] * len(sent)
        for row, (before, latest) in enumerate(zip(self._sent, mille.tolist(), strict=True)):
            # What acts on a SYNC was recorded before that; what acts at once may not be yet.
            torques = before | {latest} if self._axes[row].sync else before or {latest}
            found[row] &= _beyond(torques, set(claimed[row][-newest:]))
            late[row] = found[row] and not _beyond(torques, set(claimed[row]))
        self._new = new
        self._sent = [set(each.numbers) for each in sent]
        for each in sent:
            each.numbers.clear()
        return found, late

    def _sample(
        self,
        now_ns: int,
        received: list[Heard],
        sent: list[Heard],
        cells: list[Cell | None],
        heard: Listened,
        tension: Floats,
        most: Floats,
    ) -> None:
        """Add this look to the window, and let go what is older."""
        length = np.array(
            [
                axis.position.number(each.word) if each.count else np.nan
                for axis, each in zip(self._axes, received, strict=True)
            ]
        )
        found = [_ABSENT if cell is None else heard[cell.channel, cell.received] for cell in cells]
        sums = np.array(
            [
                [each.totals[0] for each in sent],
                [_sum(cell, each) for cell, each in zip(cells, found, strict=True)],
            ]
        )
        counts = np.array([[each.count for each in frames] for frames in (sent, found)])
        places = np.array([each.count for each in received], np.int64)
        read_ns = np.array([each.at_ns for each in received], np.int64)
        rate = np.full(len(length), np.nan)
        sample = _Sample(
            now_ns, length * self._metre, places, read_ns, sums, counts, tension, most, rate
        )
        samples = self._samples
        if samples:
            sample.rate = self._rate(samples[-1], sample)
        samples.append(sample)
        window_ns = self._settings.window_ms * 1e6
        while len(samples) > 3 and now_ns - samples[1].at_ns >= window_ns:
            samples.popleft()

    def _moved(
        self, tared: Floats | None
    ) -> tuple[Floats, Floats, Floats, Floats, NDArray[np.bool_]]:
        """Rates since the look before, of a drum whose answers are missing the last one for
        ``patience_ms`` and then 0; over the window, what of the mean torque neither the mean
        tension nor the drum's change of motion explains, that mean, and what the change takes; and
        whose encoder reports a motion that the motor's limit, the cable and ``unexplained_force``
        together cannot make. What is not explained, and what the change takes, is not known of
        that, nor where answers are missing."""
        samples = self._samples
        nothing = np.full(len(self._axes), np.nan)
        if len(samples) < 3:
            return nothing, nothing, nothing, nothing, np.zeros(len(self._axes), bool)
        first, second, before, last = samples[0], samples[1], samples[-2], samples[-1]
        self._rates = np.where(np.isnan(last.rate), self._rates, last.rate)
        recent = last.at_ns - last.read_ns <= self._settings.patience_ms * 1e6
        held = np.where(recent, self._rates, 0.0)
        rate = np.where(np.isnan(last.rate) & np.isfinite(last.length), held, last.rate)
        if last.at_ns - first.at_ns < self._settings.window_ms * 1e6:
            return rate, nothing, nothing, nothing, np.zeros(len(self._axes), bool)
        apart_s = (last.at_ns + before.at_ns - second.at_ns - first.at_ns) * 0.5e-9
        change = (last.rate - second.rate) / apart_s
        with np.errstate(divide="ignore", invalid="ignore"):
            means = (last.sums - first.sums) / (last.counts - first.counts)
        torque = means[0] * self._newton
        tare = np.zeros(len(torque)) if tared is None else tared[self._numbers]
        force = means[1] - tare
        motion = self._mass * change + self._damping * rate
        most = abs(self._limit * self._newton) + abs(force) + self._settings.unexplained_force
        incredible = abs(motion) > most
        motion[incredible] = np.nan
        return rate, torque - force - motion, torque, motion, incredible

    def _travel(self) -> Floats:
        """Where answers over the window are more, or fewer, than its ticks, those between two looks
        tell no time: the rate is one of before, or of less motion than they stand for."""
        first, last = self._samples[0], self._samples[-1]
        before = self._samples[max(0, len(self._samples) - 1 - _TRAVEL_LOOKS)]
        answered_ns = (last.places - first.places) * self._tick_ns
        irregular = abs(answered_ns - last.read_ns + first.read_ns) > _TICKS * self._tick_ns
        with np.errstate(divide="ignore", invalid="ignore"):
            found = (last.length - before.length) / ((last.read_ns - before.read_ns) * 1e-9)
        return np.where(irregular & (last.read_ns > before.read_ns), found, np.nan)

    def _rate(self, before: _Sample, now: _Sample) -> Floats:
        """Over the time between the SYNCs of the two positions, which their number tells better
        than the times of the looks: one may come just before a PDO and the other just after. Where
        that number does not fit the time between the reads, answers were lost or are too many.
        Between two answers the last rate holds."""
        answered_ns = (now.places - before.places) * self._tick_ns
        read_ns = now.read_ns - before.read_ns
        doubtful = abs(answered_ns - read_ns) > _TICKS * self._tick_ns
        time_ns = np.where(doubtful, read_ns, answered_ns)
        with np.errstate(divide="ignore", invalid="ignore"):
            rate = (now.length - before.length) / (time_ns * 1e-9)
        rate = np.where(answered_ns > 0, rate, before.rate)
        missing = now.at_ns - now.read_ns > _TICKS * self._tick_ns
        rate[missing & (answered_ns == 0)] = np.nan
        return rate


class _Since:
    """How far each tension and rate has gone since its drive's torque changed last, or the drive
    was enabled."""

    def __init__(self, axes: int) -> None:
        self._changed = np.zeros(axes, np.int64)
        self._low = self._high = np.full((2, axes), np.nan)

    def spans(
        self,
        enabled: NDArray[np.bool_],
        changed: NDArray[np.int64],
        tension: Floats,
        rate: Floats,
    ) -> tuple[Floats, Floats]:
        """``changed``: number of the PDO to each drive with which its torque changed last."""
        present, anew = np.array([tension, rate]), (changed != self._changed) | ~enabled
        self._changed = changed
        self._low = np.where(anew, present, np.fmin(self._low, present))
        self._high = np.where(anew, present, np.fmax(self._high, present))
        with np.errstate(invalid="ignore"):
            far = self._high - self._low
        far[np.isnan(far)] = 0.0
        return far[0], far[1]


def _beyond(sent: set[float], claimed: set[int]) -> bool:
    """Whether any of them is more than `_ROUNDING` off each claimed one."""
    around = range(-_ROUNDING, _ROUNDING + 1)
    return any(claimed.isdisjoint(each + off for off in around) for each in sent - claimed)


def _ages(now_ns: int, frames: list[Heard]) -> Floats:
    return np.array([age(now_ns, each) for each in frames])


def age(now_ns: int, frames: Heard) -> float:
    """ms since the last of them."""
    return (now_ns - frames.at_ns) * _MS if frames.count else np.inf


def _cell_age(now_ns: int, cell: Cell | None, heard: Listened) -> float:
    return 0.0 if cell is None else age(now_ns, heard[cell.channel, cell.received])


def _defective(cell: Cell | None, heard: Listened) -> bool:
    return cell is not None and heard[cell.channel, cell.emergency].reports_error


def _force(cell: Cell | None, heard: Listened, tared: Floats | None) -> float:
    """What is received and no number is beyond every bound."""
    if cell is None or tared is None:
        return np.nan
    each = heard[cell.channel, cell.received]
    if not each.count:
        return np.nan
    force = cell.force.number(each.word) * cell.newton
    return force - float(tared[cell.number]) if math.isfinite(force) else np.inf


def _sum(cell: Cell | None, each: Heard) -> float:
    if cell is None:
        return np.nan
    return each.totals[each.values.index(cell.force)] * cell.newton
