"""Drives and cells whose frames are not read: what the daemon records, as if it were frames.

An EtherCAT segment's frames are its master's alone. The record says what each drive was sent and
what the daemon read of its answer; in that form it is judged like what is read from a CAN channel.
"""

from __future__ import annotations

from collections import deque
from itertools import count

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.root import Config
from tonus.config.schema.sto_relay import StoRelay
from tonus.runtime.supervisor.listener import OPERATION_ENABLED, STATE, Heard
from tonus.runtime.supervisor.observation import Listened
from tonus.runtime.supervisor.record import Answers, Claim, Floats
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
        self._commanded: deque[Floats] = deque(maxlen=_DELAY_TICKS + _RISE_TICKS)
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
        found = np.full(len(self._axes), -1.0)
        for claim in claims:
            if claim.answers is not None:
                self._take(claim, claim.answers, found)
        # One that answers seldom has the torque that it answered last.
        self.astray = np.where(found < 0.0, self.astray, found)

    def _take(self, claim: Claim, answers: Answers, found: Floats) -> None:
        heard, at_ns = self.heard, claim.at_ns
        sent = np.clip(_finite(claim.torque), -self._most, self._most)
        wanted = np.rint(sent * self._mille).astype(np.int64)
        length = np.rint(_finite(claim.angle) * self._radius / _METRE).astype(np.int64)
        sampled = _anew(claim.tick, answers.age, self._sampled)
        for axis, mille, position, word, new in zip(
            self._axes,
            wanted.tolist(),
            length.tolist(),
            answers.statusword.tolist(),
            sampled.tolist(),
            strict=True,
        ):
            heard[_CHANNEL, axis.sent].take([mille], at_ns)
            if new:
                heard[_CHANNEL, axis.received].take([position << 16 | word], at_ns)
        with np.errstate(over="ignore"):  # infinite, which is beyond every bound as well
            force = answers.force.astype(np.float32).view(np.uint32)
        measured = _anew(claim.tick, answers.force_age, self._measured)
        for cell, word, status, new in zip(
            self._cells,
            force.tolist(),
            answers.force_status.tolist(),
            measured.tolist(),
            strict=True,
        ):
            if new:
                heard[_CHANNEL, cell.received].take([word], at_ns)
                heard[_CHANNEL, cell.emergency].take([status], at_ns)
        self._compare(claim, sent, answers, sampled, found)

    def _compare(
        self,
        claim: Claim,
        sent: Floats,
        answers: Answers,
        sampled: NDArray[np.bool_],
        found: Floats,
    ) -> None:
        """The drive's own torque with the least and the largest that it was ``sent`` (n,) N m
        lately, where it was sampled anew: a drive that is silent has its last one in the record.
        ``found`` (n,): what is `astray`, at most, and negative where nothing was compared."""
        enabled = answers.statusword & STATE == OPERATION_ENABLED
        self._enabled_ns[enabled] = claim.at_ns
        closed = ~enabled & (claim.at_ns - self._enabled_ns >= self._closing_ns)
        self._off_ns[closed] = claim.at_ns
        np.maximum(found, 0.0, out=found, where=~enabled)
        commanded = self._commanded
        if len(commanded) == commanded.maxlen:
            lately = np.array(commanded)
            low, high = lately.min(axis=0), lately.max(axis=0)
            # A limit of the drive's own takes torque away; it adds none, and none that is opposed.
            limited = answers.statusword & _AT_A_LIMIT != 0
            low[limited] = np.minimum(low[limited], 0.0)
            high[limited] = np.maximum(high[limited], 0.0)
            torque = _finite(answers.torque)
            beyond = np.maximum(torque - high, low - torque)
            compared = enabled & sampled & (claim.at_ns - self._off_ns > self._opening_ns)
            by = np.maximum(beyond / self._radius, 0.0)
            np.maximum(found, by, out=found, where=compared)
        # What is no number is beyond every bound.
        known = np.isfinite(answers.torque) & np.isfinite(claim.angle)
        found[~np.isfinite(claim.torque) | (sampled & ~known)] = np.inf
        commanded.append(sent)


def _anew(tick: int, age: NDArray[np.uint16], before: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which measurements are of a later tick than those before, which are then brought up. Times
    would not tell: ticks that a distributed clock paces are not equally far apart."""
    taken = tick - age.astype(np.int64)
    new: NDArray[np.bool_] = (taken > before) & (age != _NEVER)
    before[new] = taken[new]
    return new


def _finite(values: Floats) -> Floats:
    return np.where(np.isfinite(values), values, 0.0)
