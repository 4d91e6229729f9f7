"""The equations of motion in time: everything between two calls happens here, compiled.

A step is kick, drift, kick: forces change the velocities of mid-step, these move everything, and
the forces are evaluated anew.
"""

from __future__ import annotations

from math import exp
from typing import Any

from tonus.sim.plant.body import drift_body, orient, set_orientation, spin
from tonus.sim.plant.cables import pull_cables, stored, tip_speed
from tonus.sim.plant.compiled import inner, outermost
from tonus.sim.plant.contacts import press, relax
from tonus.sim.plant.cradle import rest
from tonus.sim.plant.drums import drift_drums, follow_currents, kick_drums, predict_drums, teeth


@inner
def _load(knots: Any, loads: Any, time: float) -> tuple[float, float]:
    """What the load port plays, and its rate: nothing before the schedule's start, then linear
    between knots."""
    if time < 0.0 or knots.size == 0:
        return 0.0, 0.0
    if time <= knots[0]:
        return float(loads[0]), 0.0
    for k in range(1, knots.size):
        if time < knots[k]:
            rate = (loads[k] - loads[k - 1]) / (knots[k] - knots[k - 1])
            return float(loads[k - 1] + (time - knots[k - 1]) * rate), float(rate)
    return float(loads[-1]), 0.0


@inner
def _grip(s: Any, p: Any, distance: float, rate: float) -> float:
    """Force of a port that leads the platform's origin to a distance from where it took hold."""
    for k in range(3):
        distance -= p.load_direction[k] * (s.position[k] - p.grip_origin[k])
        rate -= p.load_direction[k] * s.velocity[k]
    return float(p.grip_stiffness * distance + p.grip_damping * rate)


@inner
def _push(s: Any, p: Any) -> None:
    """Add a force on a point of the platform to the load's wrench."""
    r, point, force = s.rotation, p.push_point, p.push_force
    x = r[0, 0] * point[0] + r[0, 1] * point[1] + r[0, 2] * point[2]
    y = r[1, 0] * point[0] + r[1, 1] * point[1] + r[1, 2] * point[2]
    z = r[2, 0] * point[0] + r[2, 1] * point[1] + r[2, 2] * point[2]
    for k in range(3):
        s.load[k] += force[k]
    s.load[3] += y * force[2] - z * force[1]
    s.load[4] += z * force[0] - x * force[2]
    s.load[5] += x * force[1] - y * force[0]


@inner
def _forces(s: Any, p: Any, played: tuple[float, float], prescribed: bool) -> None:
    """Total wrench on the platform about its origin, in ``s.force`` and ``s.moment``."""
    s.dissipation = 0.0
    load = played[0]
    if p.grip_stiffness > 0.0:
        load = _grip(s, p, played[0], played[1])
    for k in range(3):
        s.load[k] = load * p.load_direction[k]
    r, point = s.rotation, p.load_point
    x = r[0, 0] * point[0] + r[0, 1] * point[1] + r[0, 2] * point[2]
    y = r[1, 0] * point[0] + r[1, 1] * point[1] + r[1, 2] * point[2]
    z = r[2, 0] * point[0] + r[2, 1] * point[1] + r[2, 2] * point[2]
    s.load[3] = y * s.load[2] - z * s.load[1]
    s.load[4] = z * s.load[0] - x * s.load[2]
    s.load[5] = x * s.load[1] - y * s.load[0]
    if p.pushed > 0.0:
        _push(s, p)
    for k in range(3):
        s.force[k] = s.load[k]
        s.moment[k] = s.load[3 + k]
    s.force[2] -= p.mass * p.gravity
    pull_cables(s, p, prescribed)
    if p.contact > 0.0:
        press(s, p)
    rest(s, p)
    if p.backlash > 0.0:
        teeth(s, p)


@inner
def _kick(s: Any, p: Any, dt: float) -> None:
    """Change the velocities of mid-step by the forces of this instant and keep the accounts.

    Work is force times mean velocity times dt, which is exactly the change of kinetic energy.
    """
    load_work = 0.0
    for k in range(3):
        old = s.half_velocity[k]
        s.half_velocity[k] = old + dt * s.force[k] / p.mass
        s.half_momentum[k] += dt * s.moment[k]
        load_work += s.load[k] * 0.5 * (old + s.half_velocity[k])
        load_work += s.load[3 + k] * s.angular_velocity[k]
    s.load_work += dt * (load_work + s.contact_force * p.contact_rate)
    s.cable_losses += dt * s.cable_dissipation
    s.losses += dt * kick_drums(s, p, dt, s.dissipation + s.relaxation)


@inner
def _predict(s: Any, p: Any, dt: float) -> None:
    """Velocities at the end of a step from those of mid-step and the last forces, so that dampers
    are as accurate as springs."""
    for k in range(3):
        s.velocity[k] = s.half_velocity[k] + dt * s.force[k] / p.mass
    predict_drums(s, p, dt)
    m, t = s.half_momentum, s.moment
    spin(s, p, m[0] + dt * t[0], m[1] + dt * t[1], m[2] + dt * t[2])


@inner
def _account(s: Any, p: Any) -> None:
    """Outputs, energies and powers of this instant."""
    m = s.half_momentum
    kinetic = 0.0
    for k in range(3):
        kinetic += 0.5 * p.mass * s.velocity[k] ** 2 + 0.5 * s.angular_velocity[k] * m[k]
    strain = 0.0
    platform = 0.0
    electrical = 0.0
    for i in range(len(s.tension)):
        kinetic += 0.5 * p.drum_inertia[i] * s.drum_rate[i] ** 2
        s.stored[i] = 0.0
        if s.elastic[i] > 0.0:
            s.stored[i] = stored(p, i, s.elastic[i], s.strain_length[i])[0]
        strain += s.stored[i]
        platform += s.tension[i] * tip_speed(s, i)
        angle, rate = s.drum_angle[i], s.drum_rate[i]
        if p.backlash > 0.0:
            angle, rate = s.rotor_angle[i], s.rotor_rate[i]
            kinetic += 0.5 * p.rotor_inertia[i] * rate**2
            strain += s.teeth_energy[i]
        turns = p.sign[i] * p.ratio[i]
        s.motor_angle[i] = turns * (p.encoder_gain[i] * angle + p.encoder_offset[i])
        s.motor_rate[i] = turns * p.encoder_gain[i] * rate
        s.motor_current[i] = p.sign[i] * s.current[i]
        electrical += p.torque_per_amp[i] * s.current[i] * rate + p.resistance * s.current[i] ** 2
    for i in range(len(s.cell_force)):
        s.cell_force[i] = p.cell_gain[i] * s.cell_filtered[i] + p.cell_offset[i]
    s.kinetic = kinetic
    s.strain = strain
    s.potential = p.mass * p.gravity * s.position[2]
    s.platform_power = platform
    s.electrical_power = electrical


@outermost
def advance(
    state: Any, parameters: Any, knots: Any, loads: Any, steps: int, dt: float, time: float
) -> None:
    """``steps`` equal kick-drift-kick steps of ``dt`` seconds; none only brings outputs up to date.

    ``time`` is the load schedule's at the start, negative while it has not begun. With
    ``parameters.opening`` = 1 the same equations are stepped by semi-implicit Euler instead, which
    is there to be compared with.
    """
    s, p = state[0], parameters[0]
    set_orientation(s, (s.quaternion[0], s.quaternion[1], s.quaternion[2], s.quaternion[3]))
    r, w = s.rotation, s.angular_velocity
    x = p.inertia[0] * (r[0, 0] * w[0] + r[1, 0] * w[1] + r[2, 0] * w[2])
    y = p.inertia[1] * (r[0, 1] * w[0] + r[1, 1] * w[1] + r[2, 1] * w[2])
    z = p.inertia[2] * (r[0, 2] * w[0] + r[1, 2] * w[1] + r[2, 2] * w[2])
    for k in range(3):
        s.half_momentum[k] = r[k, 0] * x + r[k, 1] * y + r[k, 2] * z
        s.half_velocity[k] = s.velocity[k]
    for i in range(len(s.tension)):
        s.half_rate[i] = s.drum_rate[i]
        s.half_rotor_rate[i] = s.rotor_rate[i]
    _forces(s, p, _load(knots, loads, time), False)
    closing = (1.0 - p.opening) * dt
    if steps > 0:
        _kick(s, p, p.opening * dt)
    keep_current = exp(-dt * p.current_pole)
    keep_cell = exp(-dt * p.cell_pole)
    contact = len(s.tension)
    for step in range(1, steps + 1):
        drift_body(s, p, dt)
        drift_drums(s, p, dt)
        follow_currents(s, p, keep_current)
        _predict(s, p, closing)
        if p.contact > 0.0:
            s.contact_shift += dt * p.contact_rate
            relax(s, p, dt)
        _forces(s, p, _load(knots, loads, time + step * dt), False)
        for i in range(len(s.tension)):
            s.cell_filtered[i] = s.tension[i] + (s.cell_filtered[i] - s.tension[i]) * keep_cell
        s.cell_filtered[contact] = (
            s.contact_force + (s.cell_filtered[contact] - s.contact_force) * keep_cell
        )
        if step < steps:
            _kick(s, p, dt)
        elif closing > 0.0:
            _kick(s, p, closing)
    if steps > 0:
        for k in range(3):
            s.velocity[k] = s.half_velocity[k]
        for i in range(len(s.tension)):
            s.drum_rate[i] = s.half_rate[i]
            s.rotor_rate[i] = s.half_rotor_rate[i]
        spin(s, p, s.half_momentum[0], s.half_momentum[1], s.half_momentum[2])
    _account(s, p)


@outermost
def static_wrench(state: Any, parameters: Any, prescribed: bool) -> None:
    """Wrench and geometry of the pose in ``state`` at rest, without load; see `Plant.wrench`."""
    s, p = state[0], parameters[0]
    orient(s)
    for k in range(3):
        s.velocity[k] = 0.0
        s.angular_velocity[k] = 0.0
    for i in range(len(s.tension)):
        s.drum_rate[i] = 0.0
    _forces(s, p, (0.0, 0.0), prescribed)
