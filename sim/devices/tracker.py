"""The optical tracker: sees the platform at its own rate and tells of it some milliseconds later.

A datagram is 84 bytes, little-endian (docs/tracker.md):

    offset  type       content
    0       4 bytes    b"TNTK"
    4       u16        version, 1
    6       u16        body, 0 for the platform
    8       u32        sequence, counts every exposure
    12      u32        flags; bit 0: the pose is valid
    16      i64        ns on the lab's clock at the instant of exposure
    24      3 x f64    m, platform origin in the base frame
    48      4 x f64    quaternion w x y z, platform to base
    80      f32        m, RMS residual of the pose
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Sequence
from math import cos, sin, sqrt
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.lab import Occlusion, TrackerNoise, TrackerShift
from tonus.config.schema.tracker import Tracker as TrackerConfig
from tonus.sim.plant.streams import Stream, generator

DATAGRAM = struct.Struct("<4sHHIIq3d4df")
MAGIC = b"TNTK"
VERSION = 1
PLATFORM = 0
VALID = 1
_SECOND_NS = 1_000_000_000


class Seen(Protocol):
    """What the tracker looks at."""

    @property
    def now_ns(self) -> int: ...
    @property
    def position(self) -> NDArray[np.float64]: ...
    @property
    def quaternion(self) -> NDArray[np.float64]: ...


class Tracker:
    """Exposes at ``next_ns``; whoever owns the plant brings it to that time and calls `expose`.

    ``blocked`` hides the platform: the tracker goes on sending, with the pose marked invalid. So do
    the occlusions of a script and drop-outs of its own.
    """

    def __init__(
        self,
        tracker: TrackerConfig,
        noise: TrackerNoise,
        plant: Seen,
        seed: int,
        own_seed: int | None = None,
    ) -> None:
        """``own_seed`` draws what is wrong with this tracker; None: ``seed``, as its noise."""
        self._plant = plant
        self._noise = noise
        self._random = generator(seed, Stream.TRACKER)
        self._origin_ns = plant.now_ns
        self._rate_hz = tracker.rate_hz
        self._errors = generator(seed if own_seed is None else own_seed, Stream.TRACKER_ERRORS)
        """what is wrong with this tracker, apart from its noise"""
        low, high = noise.latency_ms or (tracker.latency_ms, tracker.latency_ms)
        self._latency_ns = round(self._errors.uniform(low, high) * 1e6)
        draw = self._errors.standard_normal(6)
        self._position_bias = noise.position_bias_sigma * draw[:3]
        self._rotation_bias = noise.rotation_bias_sigma * draw[3:]
        self._lost_until_ns = self._origin_ns
        self._occlusions: tuple[Occlusion, ...] = ()
        self._shifts: tuple[TrackerShift, ...] = ()
        self._script_ns = 0
        self._jitter_ns = noise.jitter_ms * 1e6
        self._sent: deque[tuple[int, bytes]] = deque()
        self._arrival_ns = self._origin_ns
        self._sequence = 0
        self.blocked = False
        self.shift = np.zeros(3)
        """m, base frame, by which its positions are off"""
        self.next_ns = self._origin_ns
        """time of the next exposure, on the plant's clock"""

    @property
    def next_arrival_ns(self) -> int | None:
        """When the next datagram that is under way arrives."""
        return self._sent[0][0] if self._sent else None

    def start_script(
        self,
        now_ns: int,
        occlusions: Sequence[Occlusion] = (),
        shifts: Sequence[TrackerShift] = (),
    ) -> None:
        """From now on the platform is hidden, and the tracker is off, at the times of a script."""
        self._script_ns = now_ns
        self._occlusions, self._shifts = tuple(occlusions), tuple(shifts)

    def _active(self, event: Occlusion | TrackerShift, now_ns: int) -> bool:
        passed = (now_ns - self._script_ns) * 1e-9
        return event.at <= passed < event.at + event.duration

    def _hidden(self, now_ns: int) -> bool:
        if self._errors.random() < self._noise.dropout_probability:
            self._lost_until_ns = now_ns + 1 + round(self._noise.dropout_ms * 1e6)
        covered = any(self._active(occlusion, now_ns) for occlusion in self._occlusions)
        return self.blocked or covered or now_ns < self._lost_until_ns

    def expose(self, now_ns: int) -> None:
        """Look at the plant, which stands at ``now_ns``."""
        # Every exposure draws alike, seen or not, so that an occlusion shifts no later noise.
        draw = self._random.standard_normal(6)
        jitter_ns = round(self._random.uniform(-1.0, 1.0) * self._jitter_ns)
        position, quaternion, residual = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), 0.0
        hidden = self._hidden(now_ns)
        if not hidden:
            error = self._noise.position_sigma * draw[:3]
            shift, turn = self._bias(now_ns)
            position = self._on_grid(self._plant.position + error + shift)
            turn = turn + self._noise.rotation_sigma * draw[3:]
            quaternion = _turned(self._plant.quaternion, turn)
            residual = sqrt(float(error @ error) / 3.0)
        flags = 0 if hidden else VALID
        head = (MAGIC, VERSION, PLATFORM, self._sequence & 0xFFFFFFFF, flags, now_ns)
        datagram = DATAGRAM.pack(*head, *position, *quaternion, residual)
        # One link, so nothing overtakes.
        self._arrival_ns = max(self._arrival_ns, now_ns + max(0, self._latency_ns + jitter_ns))
        self._sent.append((self._arrival_ns, datagram))
        self._sequence += 1
        # From the origin each time: a sum of rounded periods would run away from the rate.
        self.next_ns = self._origin_ns + round(self._sequence * _SECOND_NS / self._rate_hz)

    def _bias(self, now_ns: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Metres, base frame, and rotation vector, platform frame."""
        position, rotation = self._position_bias + self.shift, self._rotation_bias.copy()
        for shift in self._shifts:
            if self._active(shift, now_ns):
                position += shift.position
                rotation += shift.rotation
        return position, rotation

    def _on_grid(self, position: NDArray[np.float64]) -> tuple[float, float, float]:
        grid = self._noise.position_grid
        if grid > 0.0:
            position = np.rint(position / grid) * grid
        x, y, z = position.tolist()
        return x, y, z

    def poll(self, now_ns: int) -> list[bytes]:
        """Datagrams that have arrived by ``now_ns``, in order, each handed out once."""
        arrived = []
        while self._sent and self._sent[0][0] <= now_ns:
            arrived.append(self._sent.popleft()[1])
        return arrived


def _turned(
    quaternion: NDArray[np.float64], error: NDArray[np.float64]
) -> tuple[float, float, float, float]:
    """The orientation with a small rotation vector (rad, platform frame) of error behind it."""
    w, x, y, z = quaternion.tolist()
    angle = sqrt(float(error @ error))
    scale = sin(0.5 * angle) / angle if angle > 0.0 else 0.5
    c = cos(0.5 * angle)
    turn_x, turn_y, turn_z = error.tolist()
    ex, ey, ez = scale * turn_x, scale * turn_y, scale * turn_z
    return (
        w * c - x * ex - y * ey - z * ez,
        w * ex + x * c + y * ez - z * ey,
        w * ey + y * c + z * ex - x * ez,
        w * ez + z * c + x * ey - y * ex,
    )
