"""The equations of motion, compiled: everything between two calls happens here.

All compiled functions stand in this one file on purpose: the compiler's cache watches the file of
the outermost function only, so that a callee elsewhere could change without being recompiled.

Signs: u_i points from the platform's anchor to the frame's; the wrench of the cables is W T with
columns [u_i; r_i x u_i]; a positive drum angle, torque or current winds cable in.
"""

from __future__ import annotations

from collections.abc import Callable
from math import atan2, cos, exp, sin, sqrt
from typing import Any, TypeVar, cast

from numba import njit

_Function = TypeVar("_Function", bound=Callable[..., Any])


def _compiled(function: _Function) -> _Function:
    # No fastmath: equal seeds must give equal bytes.
    try:
        return cast(_Function, njit(cache=True, error_model="numpy")(function))
    except RuntimeError:
        # Neither beside this file nor in the user's cache may anything be written: compile anew.
        return cast(_Function, njit(error_model="numpy")(function))


@_compiled
def _orient(s: Any) -> None:
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


@_compiled
def _body_rate(s: Any, p: Any, lx: float, ly: float, lz: float) -> tuple[float, float, float]:
    """Angular velocity in the platform frame from angular momentum in the base frame."""
    r = s.rotation
    return (
        (r[0, 0] * lx + r[1, 0] * ly + r[2, 0] * lz) / p.inertia[0],
        (r[0, 1] * lx + r[1, 1] * ly + r[2, 1] * lz) / p.inertia[1],
        (r[0, 2] * lx + r[1, 2] * ly + r[2, 2] * lz) / p.inertia[2],
    )


@_compiled
def _turn(
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


@_compiled
def _set_orientation(s: Any, q: tuple[float, float, float, float]) -> None:
    scale = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    s.quaternion[0] = q[0] * scale
    s.quaternion[1] = q[1] * scale
    s.quaternion[2] = q[2] * scale
    s.quaternion[3] = q[3] * scale
    _orient(s)


@_compiled
def _spin(s: Any, p: Any, lx: float, ly: float, lz: float) -> None:
    """Angular velocity in the base frame from angular momentum."""
    x, y, z = _body_rate(s, p, lx, ly, lz)
    for k in range(3):
        r = s.rotation[k]
        s.angular_velocity[k] = r[0] * x + r[1] * y + r[2] * z


@_compiled
def _drift(s: Any, p: Any, dt: float) -> None:
    """Move with the velocities of mid-step. The free body's rotation is a midpoint step that keeps
    the angular momentum exactly; no gyroscopic moment is needed."""
    for k in range(3):
        s.position[k] += dt * s.half_velocity[k]
    for i in range(8):
        s.drum_angle[i] += dt * s.half_rate[i]
    lx, ly, lz = s.half_momentum[0], s.half_momentum[1], s.half_momentum[2]
    q = (s.quaternion[0], s.quaternion[1], s.quaternion[2], s.quaternion[3])
    x, y, z = _body_rate(s, p, lx, ly, lz)
    _set_orientation(s, _turn(q, 0.5 * dt * x, 0.5 * dt * y, 0.5 * dt * z))
    x, y, z = _body_rate(s, p, lx, ly, lz)
    _set_orientation(s, _turn(q, dt * x, dt * y, dt * z))


@_compiled
def _load(knots: Any, loads: Any, time: float) -> float:
    """The load port's force: nothing before the schedule's start, then linear between knots."""
    if time < 0.0 or knots.size == 0:
        return 0.0
    if time <= knots[0]:
        return float(loads[0])
    for k in range(1, knots.size):
        if time < knots[k]:
            share = (time - knots[k - 1]) / (knots[k] - knots[k - 1])
            return float(loads[k - 1] + share * (loads[k] - loads[k - 1]))
    return float(loads[-1])


@_compiled
def _cables(s: Any, p: Any, prescribed: bool) -> None:
    """Add the cables' wrench; tensions are the elastic model's, or ``s.tension`` as prescribed.

    T = max(0, k stretch + c rate) while the cable is stretched, k = EA/L0, L0 = L0(0) - r theta.
    """
    r = s.rotation
    vx, vy, vz = s.velocity[0], s.velocity[1], s.velocity[2]
    wx, wy, wz = s.angular_velocity[0], s.angular_velocity[1], s.angular_velocity[2]
    for i in range(8):
        bx, by, bz = p.tips[i, 0], p.tips[i, 1], p.tips[i, 2]
        rx = r[0, 0] * bx + r[0, 1] * by + r[0, 2] * bz
        ry = r[1, 0] * bx + r[1, 1] * by + r[1, 2] * bz
        rz = r[2, 0] * bx + r[2, 1] * by + r[2, 2] * bz
        ux = p.anchors[i, 0] - s.position[0] - rx
        uy = p.anchors[i, 1] - s.position[1] - ry
        uz = p.anchors[i, 2] - s.position[2] - rz
        length = sqrt(ux * ux + uy * uy + uz * uz)
        ux, uy, uz = ux / length, uy / length, uz / length
        free = p.start_length[i] - p.radius * s.drum_angle[i]
        stretch = length - free
        elastic = 0.0
        tension = 0.0
        if prescribed:
            tension = s.tension[i]
        elif stretch > 0.0 and p.axial_stiffness[i] > 0.0:
            tip = (
                ux * (vx + wy * rz - wz * ry)
                + uy * (vy + wz * rx - wx * rz)
                + uz * (vz + wx * ry - wy * rx)
            )
            rate = p.radius * s.drum_rate[i] - tip
            elastic = p.axial_stiffness[i] / free * stretch
            tension = max(0.0, elastic + p.cable_damping * rate)
            s.dissipation += (tension - elastic) * rate
        s.tension[i] = tension
        s.elastic[i] = elastic
        s.strain_length[i] = free
        s.force[0] += tension * ux
        s.force[1] += tension * uy
        s.force[2] += tension * uz
        s.moment[0] += tension * (ry * uz - rz * uy)
        s.moment[1] += tension * (rz * ux - rx * uz)
        s.moment[2] += tension * (rx * uy - ry * ux)


@_compiled
def _phantom(s: Any, p: Any) -> None:
    """Add the phantom's push: a spring with a parallel damper (Kelvin-Voigt) or with a second
    spring in series with a dashpot (standard linear solid); it never pulls."""
    depth = 0.0
    rate = 0.0
    for k in range(3):
        depth -= p.contact_normal[k] * (s.position[k] - p.contact_point[k])
        rate -= p.contact_normal[k] * s.velocity[k]
    stiffness, second = p.contact_stiffness, p.relaxing_stiffness
    # The surface stands where both springs balance once the port has left it.
    surface = second * s.relaxed / (stiffness + second)
    push = 0.0
    if depth > surface:
        surface = depth
        springs = stiffness * depth + second * (depth - s.relaxed)
        push = max(0.0, springs + p.contact_damping * rate)
        s.dissipation += (push - springs) * rate
    s.contact_penetration = max(0.0, depth)
    s.contact_force = push
    s.relaxation = second * (surface - s.relaxed) ** 2 * p.relaxation_rate
    s.phantom = 0.5 * stiffness * surface**2 + 0.5 * second * (surface - s.relaxed) ** 2
    for k in range(3):
        s.force[k] += push * p.contact_normal[k]


@_compiled
def _relax(s: Any, p: Any, dt: float) -> None:
    """The dashpot's creep over a step, exact for a port that stays where it was at its start."""
    stiffness, second = p.contact_stiffness, p.relaxing_stiffness
    if s.contact_penetration > second * s.relaxed / (stiffness + second):
        depth = s.contact_penetration
        s.relaxed = depth + (s.relaxed - depth) * exp(-dt * p.relaxation_rate)
    else:
        s.relaxed *= exp(-dt * p.relaxation_rate * stiffness / (stiffness + second))


@_compiled
def _cradle(s: Any, p: Any) -> None:
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


@_compiled
def _forces(s: Any, p: Any, load: float, prescribed: bool) -> None:
    """Total wrench on the platform about its origin, in ``s.force`` and ``s.moment``."""
    s.dissipation = 0.0
    for k in range(3):
        s.load[k] = load * p.load_direction[k]
    r, point = s.rotation, p.load_point
    x = r[0, 0] * point[0] + r[0, 1] * point[1] + r[0, 2] * point[2]
    y = r[1, 0] * point[0] + r[1, 1] * point[1] + r[1, 2] * point[2]
    z = r[2, 0] * point[0] + r[2, 1] * point[1] + r[2, 2] * point[2]
    s.load[3] = y * s.load[2] - z * s.load[1]
    s.load[4] = z * s.load[0] - x * s.load[2]
    s.load[5] = x * s.load[1] - y * s.load[0]
    for k in range(3):
        s.force[k] = s.load[k]
        s.moment[k] = s.load[3 + k]
    s.force[2] -= p.mass * p.gravity
    _cables(s, p, prescribed)
    if p.contact > 0.0:
        _phantom(s, p)
    _cradle(s, p)


@_compiled
def _kick(s: Any, p: Any, dt: float) -> None:
    """Change the velocities of mid-step by the forces of this instant and keep the accounts.

    Work is force times mean velocity times dt, which is exactly the change of kinetic energy.
    Friction and gearbox loss are solved implicitly: they slow a drum at most to a standstill, where
    they hold it with any torque up to their limit.
    """
    load_work = 0.0
    for k in range(3):
        old = s.half_velocity[k]
        s.half_velocity[k] = old + dt * s.force[k] / p.mass
        s.half_momentum[k] += dt * s.moment[k]
        load_work += s.load[k] * 0.5 * (old + s.half_velocity[k])
        load_work += s.load[3 + k] * s.angular_velocity[k]
    s.load_work += dt * load_work
    losses = s.dissipation + s.relaxation
    for i in range(8):
        motor = p.torque_per_amp * s.current[i]
        drag = p.viscous * s.drum_rate[i]
        old = s.half_rate[i]
        trial = old + dt / p.drum_inertia * (motor - p.radius * s.tension[i] - drag)
        gearbox = p.driving_loss if motor * trial > 0.0 else p.driven_loss
        friction = p.coulomb + p.load_friction * p.radius * s.tension[i] + gearbox * abs(motor)
        slowing = dt / p.drum_inertia * friction
        if s.locked[i] or abs(trial) <= slowing:
            new = 0.0
        else:
            new = trial - slowing if trial > 0.0 else trial + slowing
        mean = 0.5 * (old + new)
        losses += drag * s.drum_rate[i] + p.drum_inertia * (trial - new) * mean / dt
        s.input_work += dt * motor * mean
        if s.elastic[i] > 0.0:
            s.wound -= dt * 0.5 * s.elastic[i] ** 2 / p.axial_stiffness[i] * p.radius * mean
        s.drum_acceleration[i] = (new - old) / dt
        s.half_rate[i] = new
    s.losses += dt * losses


@_compiled
def _predict(s: Any, p: Any, dt: float) -> None:
    """Velocities at the end of a step from those of mid-step and the last forces, so that dampers
    are as accurate as springs. A drum that friction holds is taken as held."""
    for k in range(3):
        s.velocity[k] = s.half_velocity[k] + dt * s.force[k] / p.mass
    for i in range(8):
        rate = s.half_rate[i]
        s.drum_rate[i] = rate + dt * s.drum_acceleration[i] if rate != 0.0 else 0.0
    m, t = s.half_momentum, s.moment
    _spin(s, p, m[0] + dt * t[0], m[1] + dt * t[1], m[2] + dt * t[2])


@_compiled
def _account(s: Any, p: Any) -> None:
    """Outputs and energies of this instant."""
    m = s.half_momentum
    kinetic = 0.0
    for k in range(3):
        kinetic += 0.5 * p.mass * s.velocity[k] ** 2 + 0.5 * s.angular_velocity[k] * m[k]
    strain = 0.0
    for i in range(8):
        kinetic += 0.5 * p.drum_inertia * s.drum_rate[i] ** 2
        if s.elastic[i] > 0.0:
            strain += 0.5 * s.elastic[i] ** 2 * s.strain_length[i] / p.axial_stiffness[i]
        s.motor_angle[i] = p.ratio * s.drum_angle[i]
        s.motor_rate[i] = p.ratio * s.drum_rate[i]
    s.kinetic = kinetic
    s.strain = strain
    s.potential = p.mass * p.gravity * s.position[2]


@_compiled
def advance(
    state: Any, parameters: Any, knots: Any, loads: Any, steps: int, dt: float, time: float
) -> None:
    """``steps`` equal kick-drift-kick steps of ``dt`` seconds; none only brings outputs up to date.

    ``time`` is the load schedule's at the start, negative while it has not begun. With
    ``parameters.opening`` = 1 the same equations are stepped by semi-implicit Euler instead, which
    is there to be compared with.
    """
    s, p = state[0], parameters[0]
    _set_orientation(s, (s.quaternion[0], s.quaternion[1], s.quaternion[2], s.quaternion[3]))
    r, w = s.rotation, s.angular_velocity
    x = p.inertia[0] * (r[0, 0] * w[0] + r[1, 0] * w[1] + r[2, 0] * w[2])
    y = p.inertia[1] * (r[0, 1] * w[0] + r[1, 1] * w[1] + r[2, 1] * w[2])
    z = p.inertia[2] * (r[0, 2] * w[0] + r[1, 2] * w[1] + r[2, 2] * w[2])
    for k in range(3):
        s.half_momentum[k] = r[k, 0] * x + r[k, 1] * y + r[k, 2] * z
        s.half_velocity[k] = s.velocity[k]
    for i in range(8):
        s.half_rate[i] = s.drum_rate[i]
    _forces(s, p, _load(knots, loads, time), False)
    closing = (1.0 - p.opening) * dt
    if steps > 0:
        _kick(s, p, p.opening * dt)
    keep_current = exp(-dt * p.current_pole)
    keep_cell = exp(-dt * p.cell_pole)
    for step in range(1, steps + 1):
        _drift(s, p, dt)
        for i in range(8):
            goal = s.current_reference[i] if s.powered[i] else 0.0
            goal = min(p.current_limit, max(-p.current_limit, goal))
            s.current[i] = goal + (s.current[i] - goal) * keep_current
        _predict(s, p, closing)
        if p.contact > 0.0:
            _relax(s, p, dt)
        _forces(s, p, _load(knots, loads, time + step * dt), False)
        for i in range(8):
            s.cell_force[i] = s.tension[i] + (s.cell_force[i] - s.tension[i]) * keep_cell
        s.cell_force[8] = s.contact_force + (s.cell_force[8] - s.contact_force) * keep_cell
        if step < steps:
            _kick(s, p, dt)
        elif closing > 0.0:
            _kick(s, p, closing)
    if steps > 0:
        for k in range(3):
            s.velocity[k] = s.half_velocity[k]
        for i in range(8):
            s.drum_rate[i] = s.half_rate[i]
        _spin(s, p, s.half_momentum[0], s.half_momentum[1], s.half_momentum[2])
    _account(s, p)


@_compiled
def static_wrench(state: Any, parameters: Any, prescribed: bool) -> None:
    """Wrench of the pose in ``state`` at rest, without load; see `Plant.wrench`."""
    s, p = state[0], parameters[0]
    _orient(s)
    for k in range(3):
        s.velocity[k] = 0.0
        s.angular_velocity[k] = 0.0
    for i in range(8):
        s.drum_rate[i] = 0.0
    _forces(s, p, 0.0, prescribed)
