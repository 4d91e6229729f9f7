"""The cables: their way from platform to drum, how they stretch, and what they pull.

Signs: u_i points from the platform's anchor to where the cable leaves for the frame; the wrench of
the cables is W T with columns [u_i; r_i x u_i].
"""

from __future__ import annotations

from math import atan2, cos, expm1, log1p, sin, sqrt
from typing import Any

from tonus.sim.plant.compiled import inner


@inner
def _course(s: Any, p: Any, i: int) -> None:
    """Lever, direction and length of a cable from the frame's anchor to the platform's."""
    r = s.rotation
    bx, by, bz = p.tips[i, 0], p.tips[i, 1], p.tips[i, 2]
    rx = r[0, 0] * bx + r[0, 1] * by + r[0, 2] * bz
    ry = r[1, 0] * bx + r[1, 1] * by + r[1, 2] * bz
    rz = r[2, 0] * bx + r[2, 1] * by + r[2, 2] * bz
    ux = p.anchors[i, 0] - s.position[0] - rx
    uy = p.anchors[i, 1] - s.position[1] - ry
    uz = p.anchors[i, 2] - s.position[2] - rz
    if p.pulley_radius > 0.0:
        # The pulley stands upright and turns about the vertical through the anchor, up which the
        # cable comes; it leaves on a tangent after winding round by `wrap`.
        across = max(1e-12, sqrt(ux * ux + uy * uy))
        beyond = across - p.pulley_radius
        free = sqrt(max(0.0, beyond * beyond + uz * uz - p.pulley_radius * p.pulley_radius))
        wrap = atan2(beyond, -uz) + atan2(p.pulley_radius, free)
        length = p.pulley_radius * wrap + free
        ux, uy, uz = sin(wrap) * ux / across, sin(wrap) * uy / across, -cos(wrap)
    else:
        length = sqrt(ux * ux + uy * uy + uz * uz)
        ux, uy, uz = ux / length, uy / length, uz / length
    s.lever[i, 0], s.lever[i, 1], s.lever[i, 2] = rx, ry, rz
    s.direction[i, 0], s.direction[i, 1], s.direction[i, 2] = ux, uy, uz
    s.length[i] = length


@inner
def tip_speed(s: Any, i: int) -> float:
    """Of the platform's anchor along its cable, shortening positive (m/s)."""
    u, r, v, w = s.direction[i], s.lever[i], s.velocity, s.angular_velocity
    return float(
        u[0] * (v[0] + w[1] * r[2] - w[2] * r[1])
        + u[1] * (v[1] + w[2] * r[0] - w[0] * r[2])
        + u[2] * (v[2] + w[0] * r[1] - w[1] * r[0])
    )


@inner
def _pull(p: Any, i: int, stretch: float, free: float) -> float:
    """Tension of a cable of unstretched length ``free``: dT/de = EA0 + g T over the strain e, so
    T = EA0 e, or with g > 0 EA0 (exp(g e) - 1) / g."""
    if p.stiffening[i] > 0.0:
        return float(
            p.axial_stiffness[i] / p.stiffening[i] * expm1(p.stiffening[i] * stretch / free)
        )
    return float(p.axial_stiffness[i] / free * stretch)


@inner
def stored(p: Any, i: int, tension: float, metres: float) -> tuple[float, float]:
    """Energy of so many unstretched metres of a cable under elastic tension, and its complement
    (tension times stretch less the energy), which the drum's work lacks when it winds them on."""
    if p.stiffening[i] > 0.0:
        strain = log1p(p.stiffening[i] * tension / p.axial_stiffness[i]) / p.stiffening[i]
        energy = (tension - p.axial_stiffness[i] * strain) / p.stiffening[i]
        return energy * metres, (tension * strain - energy) * metres
    energy = 0.5 * tension**2 * metres / p.axial_stiffness[i]
    return energy, energy


@inner
def pull_cables(s: Any, p: Any, prescribed: bool) -> None:
    """Add the cables' wrench; tensions are the elastic model's, or ``s.tension`` as prescribed.

    T = max(0, elastic + c rate) while the cable is stretched, L0 = L0(0) - r theta + slipped.
    """
    for i in range(len(s.tension)):
        _course(s, p, i)
        free = p.start_length[i] - p.radius[i] * s.drum_angle[i] + s.slipped[i]
        stretch = s.length[i] - free
        elastic = 0.0
        tension = 0.0
        if prescribed:
            tension = s.tension[i]
        elif stretch > 0.0 and p.axial_stiffness[i] > 0.0:
            rate = p.radius[i] * s.drum_rate[i] - p.slip_rate[i] - tip_speed(s, i)
            elastic = _pull(p, i, stretch, free)
            tension = max(0.0, elastic + p.cable_damping[i] * rate)
            s.dissipation += (tension - elastic) * rate
        s.tension[i] = tension
        s.elastic[i] = elastic
        s.strain_length[i] = free
        ux, uy, uz = s.direction[i, 0], s.direction[i, 1], s.direction[i, 2]
        rx, ry, rz = s.lever[i, 0], s.lever[i, 1], s.lever[i, 2]
        s.force[0] += tension * ux
        s.force[1] += tension * uy
        s.force[2] += tension * uz
        s.moment[0] += tension * (ry * uz - rz * uy)
        s.moment[1] += tension * (rz * ux - rx * uz)
        s.moment[2] += tension * (rx * uy - ry * ux)
    s.cable_dissipation = s.dissipation
