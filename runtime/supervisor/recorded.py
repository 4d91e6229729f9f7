"""Drives and cells whose frames are not read: what the daemon records, as if it were frames.

An EtherCAT segment's frames are its master's alone. The record says what each drive was sent and
what the daemon read of its answer; in that form it is judged like what is read from a CAN channel.
"""

from __future__ import annotations

from itertools import count
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tonus.config.schema.root import Config
from tonus.config.schema.sto_relay import StoRelay
from tonus.runtime.supervisor.listener import OPERATION_ENABLED, STATE, Heard
from tonus.runtime.supervisor.observation import Listened
from tonus.runtime.supervisor.record import Claim, Floats
from tonus.runtime.supervisor.wiring import Axis, Cell, Value, Wiring, limit_of

_CHANNEL = ""
_NO_FRAME = 0
"""bytes of what is in no frame"""
_TORQUE, _STATUSWORD, _POSITION = Value(0, 32), Value(0, 16), Value(16, 48)
_FORCE = Value(0, 32, real=True)
_METRE = 1e-9
"""of cable, the grid of a position"""
_AT_A_LIMIT = 0x0800
"""CiA 402, statusword"""
_NEVER = 0xFFFF
"""age of what was never measured"""
_BEFORE = np.int64(-_NEVER)
"""a tick before every measurement"""
_DELAY_TICKS = 6
"""records in which a torque may come back as the drive's own figure: sent, acting, sampled, read;
and as many lost frames as stop nothing"""
_RISE_TICKS = 2
"""by which the drive's current follows"""
_LATELY = _DELAY_TICKS + _RISE_TICKS
_ALL = slice(None)


class RecordedWiring(Wiring):
    """Every axis and cell of the robot, as a drive and an amplifier on a channel without a name;
    ``channels`` has the relay's."""

    def __init__(self, config: Config, relay: StoRelay) -> None:
        robot = config.robot
        self.channels = [(relay.interface, relay.channel, relay.bitrate)]
        self.axes = []
        identifiers = count()  # without frames they only have to differ
        for number, (train, sign) in enumerate(zip(robot.drive_trains, robot.signs, strict=True)):
            ratio, radius = train.gearbox.ratio, train.drum.radius
            mille = sign * train.motor.rated_torque * 1e-3
            self.axes.append(
                Axis(
                    number,
                    _CHANNEL,
                    next(identifiers),
                    next(identifiers),
                    _NO_FRAME,
                    _NO_FRAME,
                    _TORQUE,
                    _STATUSWORD,
                    _POSITION,
                    mille * ratio / radius,
                    1.0 / (mille * ratio),
                    limit_of(train.motor),
                    _METRE,
                    train.drum.inertia / radius**2,
                    train.drum.viscous_friction / radius**2,
                    None,
                )
            )
        self.cells = [
            Cell(number, _CHANNEL, next(identifiers), _NO_FRAME, _FORCE, 1.0, next(identifiers))
            for number in range(robot.cells)
        ]


class Replayed:
    """Records as frames, each read when its tick was due; a measurement that is a repetition of an
    older one is none."""

    def __init__(self, config: Config, wiring: RecordedWiring) -> None:
        self._axes, self._cells = wiring.axes, wiring.cells
        self._radius = np.array([train.drum.radius for train in config.robot.drive_trains])
        self._mille = np.array([axis.per_newton_metre for axis in wiring.axes])
        self._most = np.array([axis.limit for axis in wiring.axes]) / abs(self._mille)
        """N m (n,); a torque is recorded as control has it, and sent within the motor's limit"""
        self._sampled = np.full(len(wiring.axes), _BEFORE)
        self._measured = np.full(len(wiring.cells), _BEFORE)
        self._commanded = np.empty((0, len(wiring.axes)))
        """N m (`_LATELY` or fewer, n), the newest last"""
        brakes = [train.brake for train in config.robot.drive_trains]
        self._opening_ns = np.array([brake.opening_ms * 1e6 if brake else 0.0 for brake in brakes])
        self._opening_ns[self._opening_ns > 0.0] += _DELAY_TICKS * config.control.rates.period_ns
        """ns (n,) from enabling on, in which the drive holds a motor whose brake still opens"""
        self._closing_ns = np.array([brake.closing_ms * 1e6 if brake else 0.0 for brake in brakes])
        """ns (n,) without power in which a brake closes"""
        self._enabled_ns = np.zeros(len(wiring.axes))
        """when a drive was enabled last"""
        self._off_ns = np.zeros(len(wiring.axes))
        """when one was last not enabled for so long that its brake was closed"""
        self.astray = np.zeros(len(wiring.axes))
        """N at each cable by which the drive's own torque was outside of what it was sent, at most
        in the records taken last in which it was sampled anew; 0 while it is not enabled"""
        self.heard: Listened = {
            (_CHANNEL, identifier): heard
            for identifier, heard in (
                *((axis.sent, Heard((_TORQUE,))) for axis in wiring.axes),
                *((axis.received, Heard((), _STATUSWORD)) for axis in wiring.axes),
                *((cell.received, Heard((_FORCE,))) for cell in wiring.cells),
                *((cell.emergency, Heard(())) for cell in wiring.cells),
            )
        }

    def take(self, claims: list[Claim]) -> None:
        """Claims with their answers, in their order."""
        answers = [claim.answers for claim in claims if claim.answers is not None]
        if not answers:
            return
        ticks = np.array([claim.tick for claim in claims])[:, None]
        at_ns = np.array([claim.at_ns for claim in claims])
        torque = np.array([claim.torque for claim in claims])
        angle = np.array([claim.angle for claim in claims])
        sent = np.clip(_finite(torque), -self._most, self._most)
        wanted = np.rint(sent * self._mille).astype(np.int64)
        length = np.rint(_finite(angle) * self._radius / _METRE).astype(np.int64)
        word = np.array([each.statusword for each in answers])
        sampled = _anew(ticks, np.array([each.age for each in answers]), self._sampled)
        answered = length << 16 | word
        for row, axis in enumerate(self._axes):
            self._hear(axis.sent, wanted[:, row], at_ns)
            self._hear(axis.received, answered[:, row], at_ns, sampled[:, row])
        with np.errstate(over="ignore"):  # infinite, which is beyond every bound as well
            force = np.array([each.force for each in answers], np.float32).view(np.uint32)
        status = np.array([each.force_status for each in answers])
        measured = _anew(ticks, np.array([each.force_age for each in answers]), self._measured)
        for row, cell in enumerate(self._cells):
            self._hear(cell.received, force[:, row], at_ns, measured[:, row])
            self._hear(cell.emergency, status[:, row], at_ns, measured[:, row])
        answer = np.array([each.torque for each in answers])
        known = np.isfinite(answer) & np.isfinite(angle)
        unknown = ~np.isfinite(torque) | (sampled & ~known)
        self._compare(at_ns[:, None], sent, word, _finite(answer), sampled, unknown)

    def _hear(
        self,
        identifier: int,
        words: NDArray[Any],
        at_ns: NDArray[np.int64],
        new: NDArray[np.bool_] | slice = _ALL,
    ) -> None:
        """``words`` (m,) of the records, those that are ``new``."""
        taken = words[new].tolist()
        if taken:
            self.heard[_CHANNEL, identifier].take(taken, int(at_ns[new][-1]))

    def _compare(
        self,
        at_ns: NDArray[np.int64],
        sent: Floats,
        word: NDArray[np.uint16],
        torque: Floats,
        sampled: NDArray[np.bool_],
        unknown: NDArray[np.bool_],
    ) -> None:
        """The drive's own ``torque`` with the least and the largest that it was ``sent``, both N m
        (m, n), before that record, where it was sampled anew: a drive that is silent has its last
        one in the record. What is ``unknown`` is beyond every bound."""
        enabled = word & STATE == OPERATION_ENABLED
        enabled_ns = _latest(self._enabled_ns, at_ns, enabled)
        closed = ~enabled & (at_ns - enabled_ns >= self._closing_ns)
        off_ns = _latest(self._off_ns, at_ns, closed)
        self._enabled_ns, self._off_ns = enabled_ns[-1], off_ns[-1]
        found = np.where(enabled, -1.0, 0.0)
        commanded = np.concatenate([self._commanded, sent])
        self._commanded = commanded[-_LATELY:]
        first = max(len(sent) - len(commanded) + _LATELY, 0)  # that has so many before it
        if first < len(sent):
            lately = sliding_window_view(commanded[:-1], _LATELY, axis=0)
            low, high = lately.min(axis=-1), lately.max(axis=-1)
            # A limit of the drive's own takes torque away; it adds none, and none that is opposed.
            limited = word[first:] & _AT_A_LIMIT != 0
            low = np.where(limited, np.minimum(low, 0.0), low)
            high = np.where(limited, np.maximum(high, 0.0), high)
            beyond = np.maximum(torque[first:] - high, low - torque[first:])
            by = np.maximum(beyond / self._radius, 0.0)
            compared = (enabled & sampled & (at_ns - off_ns > self._opening_ns))[first:]
            found[first:] = np.where(compared, by, found[first:])
        found[unknown] = np.inf
        most = found.max(axis=0)
        # One that answers seldom has the torque that it answered last.
        self.astray = np.where(most < 0.0, self.astray, most)


def _anew(
    ticks: NDArray[np.int64], age: NDArray[np.uint16], before: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Which measurements (m, n) are of a later tick than those before (n,), which are then brought
    up. Times would not tell: ticks that a distributed clock paces are not equally far apart."""
    taken = np.where(age == _NEVER, _BEFORE, ticks - age)
    newest = np.maximum.accumulate(np.concatenate([before[None], taken]))
    before[:] = newest[-1]
    new: NDArray[np.bool_] = taken > newest[:-1]
    return new


def _latest(before: Floats, at_ns: NDArray[np.int64], where: NDArray[np.bool_]) -> Floats:
    """When it was so last, by each record (m, n)."""
    found = np.concatenate([before[None], np.where(where, at_ns, -np.inf)])
    latest: Floats = np.maximum.accumulate(found)[1:]
    return latest


def _finite(values: Floats) -> Floats:
    return np.where(np.isfinite(values), values, 0.0)
