"""The cradle: a level table with friction, and in it a cup for each lower corner of the platform.

The platform is a box for it: the bounding box of its cable anchors. Each of the eight corners may
stand on the table by itself, so that a platform lies flat only while the table carries it.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

from tonus.sim.plant.compiled import inner


@inner
def _damped(tx: float, ty: float, vx: float, vy: float, limit: float) -> float:
    """The share of a damper's force (vx, vy) that fits beside a spring's force (tx, ty) of at most
    ``limit`` into the friction circle of that radius."""
    square = vx * vx + vy * vy
    if square <= 0.0:
        return 0.0
    along = tx * vx + ty * vy
    room = max(0.0, limit * limit - tx * tx - ty * ty)
    return float(min(1.0, (sqrt(along * along + square * room) - along) / square))


@inner
def _stick(s: Any, p: Any, c: int, place: tuple[float, float], push: float) -> None:
    """Move a corner's foot so far that the spring between both stays in the friction circle.

    What the foot slides is lost: by the mean of the force before and after, as the platform's work
    over the step is (see `tonus.sim.plant.kernel`), and never less than nothing.
    """
    if s.standing[c] == 0.0:
        s.standing[c] = 1.0
        s.foot[c, 0], s.foot[c, 1] = place[0], place[1]
    reach = p.cradle_friction * push / p.corner_stiffness
    tx, ty = place[0] - s.foot[c, 0], place[1] - s.foot[c, 1]
    square = tx * tx + ty * ty
    if square > reach * reach:
        share = reach / sqrt(square)
        slid_x, slid_y = (1.0 - share) * tx, (1.0 - share) * ty
        tx, ty = share * tx, share * ty
        work = (s.bristle[c, 0] + tx) * slid_x + (s.bristle[c, 1] + ty) * slid_y
        s.losses += max(0.0, 0.5 * p.corner_stiffness * work)
        s.foot[c, 0] += slid_x
        s.foot[c, 1] += slid_y
    s.bristle[c, 0], s.bristle[c, 1] = tx, ty
    s.cradle += 0.5 * p.corner_stiffness * (tx * tx + ty * ty)


@inner
def _stand(s: Any, p: Any, c: int, corner: tuple[float, float, float]) -> None:
    """Add the table's force on one corner: a unilateral spring-damper upright on its surface, and
    friction that sticks by a spring-damper and slides at Coulomb's limit."""
    r = s.rotation
    rx = r[0, 0] * corner[0] + r[0, 1] * corner[1] + r[0, 2] * corner[2]
    ry = r[1, 0] * corner[0] + r[1, 1] * corner[1] + r[1, 2] * corner[2]
    rz = r[2, 0] * corner[0] + r[2, 1] * corner[1] + r[2, 2] * corner[2]
    x, y = s.position[0] + rx, s.position[1] + ry
    height, slope_x, slope_y = p.table_height, 0.0, 0.0
    if c < 4:
        dx, dy = x - p.cradle_place[0] - corner[0], y - p.cradle_place[1] - corner[1]
        rim = 1.0 - (dx * dx + dy * dy) / p.cradle_radius**2
        if rim > 0.0:
            height -= p.cradle_depth * rim * rim
            slope = 4.0 * p.cradle_depth * rim / p.cradle_radius**2
            slope_x, slope_y = slope * dx, slope * dy
    depth = height - s.position[2] - rz
    if depth <= 0.0 and s.standing[c] == 0.0:
        return
    w = s.angular_velocity
    vx = s.velocity[0] + w[1] * rz - w[2] * ry
    vy = s.velocity[1] + w[2] * rx - w[0] * rz
    vz = s.velocity[2] + w[0] * ry - w[1] * rx
    push = 0.0
    if depth > 0.0:
        rate = slope_x * vx + slope_y * vy - vz
        spring = p.corner_stiffness * depth
        push = max(0.0, spring + p.corner_damping * rate)
        s.dissipation += (push - spring) * rate
        s.cradle += 0.5 * spring * depth
    _stick(s, p, c, (x, y), push)
    if depth <= 0.0:
        s.standing[c] = 0.0
        return
    s.resting = 1.0
    tx, ty = p.corner_stiffness * s.bristle[c, 0], p.corner_stiffness * s.bristle[c, 1]
    drag_x, drag_y = p.corner_damping * vx, p.corner_damping * vy
    share = _damped(tx, ty, drag_x, drag_y, p.cradle_friction * push)
    s.dissipation += share * (drag_x * vx + drag_y * vy)
    fx = -push * slope_x - tx - share * drag_x
    fy = -push * slope_y - ty - share * drag_y
    s.force[0] += fx
    s.force[1] += fy
    s.force[2] += push
    s.moment[0] += ry * push - rz * fy
    s.moment[1] += rz * fx - rx * push
    s.moment[2] += rx * fy - ry * fx


@inner
def rest(s: Any, p: Any) -> None:
    """Add the table's wrench on the platform; ``s.cradle`` becomes its springs' energy."""
    s.cradle = 0.0
    r, half, ends = s.rotation, p.box_half, p.box_ends
    lowest = s.position[2] - abs(r[2, 0]) * half[0] - abs(r[2, 1]) * half[1]
    lowest += min(r[2, 2] * ends[0], r[2, 2] * ends[1])
    if lowest >= p.table_height and s.resting == 0.0:
        return
    s.resting = 0.0
    for c in range(8):
        x = half[0] if c & 1 else -half[0]
        y = half[1] if c & 2 else -half[1]
        _stand(s, p, c, (x, y, ends[1] if c & 4 else ends[0]))
