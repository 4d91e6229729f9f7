"""The phantom, which the contact port may press."""

from __future__ import annotations

from math import exp
from typing import Any

from tonus.sim.plant.compiled import inner


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
    depth = float(s.contact_shift)
    for k in range(3):
        depth -= p.contact_normal[k] * (s.position[k] - p.contact_point[k])
    return depth


@inner
def press(s: Any, p: Any) -> None:
    """Add the phantom's push: a spring with a parallel damper (Kelvin-Voigt) or with a second
    spring in series with a dashpot (standard linear solid); it never pulls."""
    depth = _depth(s, p)
    rate = p.contact_rate
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
