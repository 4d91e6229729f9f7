"""What the platform may touch: the phantom and the cradle."""

from __future__ import annotations

from math import atan2, exp, sqrt
from typing import Any

from sim.plant.compiled import inner


@inner
def _surface(s: Any, p: Any) -> float:
    """Where the phantom's surface stands once the port has left it, as a depth: a standard linear
    solid's at once where both springs balance, a Kelvin-Voigt body's where its dashpot is."""
    if p.solid > 0.0:
        return float(
            p.relaxing_stiffness * s.relaxed / (p.contact_stiffness + p.relaxing_stiffness)
        )
    return float(s.relaxed)


@inner
def _depth(s: Any, p: Any) -> float:
    """Of the contact port behind the undisturbed surface, negative in front of it."""
    depth = 0.0
    for k in range(3):
        depth -= p.contact_normal[k] * (s.position[k] - p.contact_point[k])
    return depth


@inner
def press(s: Any, p: Any) -> None:
    """Add the phantom's push: a spring with a parallel damper (Kelvin-Voigt) or with a second
    spring in series with a dashpot (standard linear solid); it never pulls."""
    depth = _depth(s, p)
    rate = 0.0
    for k in range(3):
        rate -= p.contact_normal[k] * s.velocity[k]
    stiffness, second = p.contact_stiffness, p.relaxing_stiffness
    surface = _surface(s, p)
    push = 0.0
    if depth > 0.0 and depth >= surface:
        surface = depth
        springs = stiffness * depth + second * (depth - s.relaxed)
        push = max(0.0, springs + p.contact_damping * rate)
        s.dissipation += (push - springs) * rate
        if p.solid == 0.0:
            s.relaxed = depth
    s.contact_penetration = max(0.0, depth)
    s.contact_force = push
    s.relaxation = second * (surface - s.relaxed) ** 2 * p.relaxation_rate
    s.phantom = 0.5 * stiffness * surface**2 + 0.5 * second * (surface - s.relaxed) ** 2
    for k in range(3):
        s.force[k] += push * p.contact_normal[k]


@inner
def relax(s: Any, p: Any, dt: float) -> None:
    """The dashpot's creep over a step: exact for a solid whose port stays where it was at its
    start, and for a Kelvin-Voigt body whose port is faster than its surface can follow."""
    if p.solid > 0.0 and s.contact_penetration > _surface(s, p):
        depth = s.contact_penetration
        s.relaxed = depth + (s.relaxed - depth) * exp(-dt * p.relaxation_rate)
        return
    start = s.relaxed
    s.relaxed *= exp(-dt * p.recovery_rate)
    if p.solid == 0.0 and _depth(s, p) <= s.relaxed:
        s.losses += 0.5 * p.contact_stiffness * (start**2 - s.relaxed**2)


@inner
def rest(s: Any, p: Any) -> None:
    """Add the cradle: a unilateral spring-damper from below; sideways and in rotation it holds with
    the share of the platform's weight that rests on it, so that lifting off is without a jerk.
    Only the vertical spring stores energy in the accounts, the rest counts as dissipation."""
    depth = p.cradle_height - s.position[2]
    s.cradle = 0.0
    if depth <= 0.0:
        return
    spring = p.cradle_stiffness * depth
    s.cradle = 0.5 * spring * depth
    support = max(0.0, spring - p.cradle_damping * s.velocity[2])
    share = min(1.0, support / (p.mass * p.gravity))
    s.force[2] += support
    s.dissipation += (spring - support) * s.velocity[2]
    for k in range(2):
        hold = share * (
            p.cradle_stiffness * (s.position[k] - p.cradle_place[k])
            + p.cradle_damping * s.velocity[k]
        )
        s.force[k] -= hold
        s.dissipation += hold * s.velocity[k]
    sine = sqrt(s.quaternion[1] ** 2 + s.quaternion[2] ** 2 + s.quaternion[3] ** 2)
    side = 1.0 if s.quaternion[0] >= 0.0 else -1.0
    scale = 2.0 * side * atan2(sine, side * s.quaternion[0]) / sine if sine > 1e-12 else 2.0 * side
    for k in range(3):
        hold = share * (
            p.cradle_rotational_stiffness * scale * s.quaternion[1 + k]
            + p.cradle_rotational_damping * s.angular_velocity[k]
        )
        s.moment[k] -= hold
        s.dissipation += hold * s.angular_velocity[k]
