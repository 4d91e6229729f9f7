"""The platform as a free rigid body: orientation, angular momentum, motion between forces."""

from __future__ import annotations

from math import cos, sin, sqrt
from typing import Any

from tonus.sim.plant.compiled import inner


@inner
def orient(s: Any) -> None:
    """Rotation matrix of the quaternion."""
    w, x, y, z = s.quaternion[0], s.quaternion[1], s.quaternion[2], s.quaternion[3]
    s.rotation[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    s.rotation[0, 1] = 2.0 * (x * y - w * z)
    s.rotation[0, 2] = 2.0 * (x * z + w * y)
    s.rotation[1, 0] = 2.0 * (x * y + w * z)
    s.rotation[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    s.rotation[1, 2] = 2.0 * (y * z - w * x)
    s.rotation[2, 0] = 2.0 * (x * z - w * y)
    s.rotation[2, 1] = 2.0 * (y * z + w * x)
    s.rotation[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@inner
def _body_rate(s: Any, p: Any, lx: float, ly: float, lz: float) -> tuple[float, float, float]:
    """Angular velocity in the platform frame from angular momentum in the base frame."""
    r = s.rotation
    return (
        (r[0, 0] * lx + r[1, 0] * ly + r[2, 0] * lz) / p.inertia[0],
        (r[0, 1] * lx + r[1, 1] * ly + r[2, 1] * lz) / p.inertia[1],
        (r[0, 2] * lx + r[1, 2] * ly + r[2, 2] * lz) / p.inertia[2],
    )


@inner
def _turned(
    q: tuple[float, float, float, float], x: float, y: float, z: float
) -> tuple[float, float, float, float]:
    """q times the quaternion of the rotation vector (x, y, z), which is in the platform frame."""
    angle = sqrt(x * x + y * y + z * z)
    scale = sin(0.5 * angle) / angle if angle > 1e-12 else 0.5
    c, x, y, z = cos(0.5 * angle), x * scale, y * scale, z * scale
    return (
        q[0] * c - q[1] * x - q[2] * y - q[3] * z,
        q[0] * x + q[1] * c + q[2] * z - q[3] * y,
        q[0] * y + q[2] * c + q[3] * x - q[1] * z,
        q[0] * z + q[3] * c + q[1] * y - q[2] * x,
    )


@inner
def set_orientation(s: Any, q: tuple[float, float, float, float]) -> None:
    """Take the quaternion, normalised, and its rotation matrix."""
    scale = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    s.quaternion[0] = q[0] * scale
    s.quaternion[1] = q[1] * scale
    s.quaternion[2] = q[2] * scale
    s.quaternion[3] = q[3] * scale
    orient(s)


@inner
def spin(s: Any, p: Any, lx: float, ly: float, lz: float) -> None:
    """Angular velocity in the base frame from angular momentum."""
    x, y, z = _body_rate(s, p, lx, ly, lz)
    for k in range(3):
        r = s.rotation[k]
        s.angular_velocity[k] = r[0] * x + r[1] * y + r[2] * z


@inner
def drift_body(s: Any, p: Any, dt: float) -> None:
    """Move with the velocities of mid-step. The free body's rotation is a midpoint step that keeps
    the angular momentum exactly; no gyroscopic moment is needed."""
    for k in range(3):
        s.position[k] += dt * s.half_velocity[k]
    lx, ly, lz = s.half_momentum[0], s.half_momentum[1], s.half_momentum[2]
    q = (s.quaternion[0], s.quaternion[1], s.quaternion[2], s.quaternion[3])
    x, y, z = _body_rate(s, p, lx, ly, lz)
    set_orientation(s, _turned(q, 0.5 * dt * x, 0.5 * dt * y, 0.5 * dt * z))
    x, y, z = _body_rate(s, p, lx, ly, lz)
    set_orientation(s, _turned(q, dt * x, dt * y, dt * z))
