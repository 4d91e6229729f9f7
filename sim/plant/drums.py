"""Motors, gearboxes and drums. A positive angle, torque or current winds cable in; only what the
drives see and write of a motor has that motor's own sign.

Inertia, friction and the rotor's angle are taken at the drum. As a rule rotor and drum are one
body; with backlash they are two, with the play and the elastic teeth between them.
"""

from __future__ import annotations

from math import exp
from typing import Any

from tonus.sim.plant.cables import stored
from tonus.sim.plant.compiled import inner


@inner
def follow_currents(s: Any, p: Any, keep: float) -> None:
    """Bring every current nearer to its reference, which is bounded; ``keep`` is the share of the
    difference that remains."""
    for i in range(len(s.tension)):
        goal = p.sign[i] * s.current_reference[i] if s.powered[i] else 0.0
        goal = min(p.current_limit[i], max(-p.current_limit[i], goal))
        s.current[i] = goal + (s.current[i] - goal) * keep


@inner
def _slowed(trial: float, slowing: float) -> float:
    """A rate that friction lowers by ``slowing``, to a standstill at most."""
    if abs(trial) <= slowing:
        return 0.0
    return trial - slowing if trial > 0.0 else trial + slowing


@inner
def _sliding(p: Any, i: int, friction: float, rate: float) -> float:
    """Friction torque at a speed: it rises towards standstill as Stribeck found."""
    if p.stribeck > 0.0:
        ratio = rate / p.stribeck_rate[i]
        return float(friction * (1.0 + p.stribeck * exp(-ratio * ratio)))
    return friction


@inner
def _gearbox(p: Any, i: int, motor: float, rate: float) -> float:
    """The torque that the gearbox takes, against the motion: driving the cable, the motor loses
    1 - eta of its own; driven by it, it holds 1/eta as much as its own."""
    return float((p.driving_loss[i] if motor * rate > 0.0 else p.driven_loss[i]) * abs(motor))


@inner
def _lost(s: Any, work: float, dt: float) -> float:
    """The power (W) of work (J) that friction takes over a step. Where it comes out negative it was
    done from outside: in the step in which a drum is stopped as it turns back, and by whatever
    pulls cable back on to its drum."""
    if work < 0.0:
        s.input_work -= work
        return 0.0
    return work / dt


@inner
def teeth(s: Any, p: Any) -> None:
    """Torque from rotor to drum through the play: nothing inside it, elastic teeth on either side,
    which push and do not stick."""
    s.teeth_dissipation = 0.0
    for i in range(len(s.tension)):
        twist = s.rotor_angle[i] - s.drum_angle[i]
        bent = max(0.0, abs(twist) - p.half_play)
        side = 1.0 if twist > 0.0 else -1.0
        elastic = p.teeth_stiffness * bent
        torque = 0.0
        if bent > 0.0:
            rate = s.rotor_rate[i] - s.drum_rate[i]
            torque = side * max(0.0, elastic + side * p.teeth_damping * rate)
            s.teeth_dissipation += (torque - side * elastic) * rate
        s.teeth_torque[i] = torque
        s.teeth_energy[i] = 0.5 * elastic * bent


@inner
def _kick_rotor(s: Any, p: Any, i: int, motor: float, dt: float) -> tuple[float, float]:
    """The rotor's mean rate over the kick and the power it loses."""
    drag = p.rotor_viscous[i] * s.rotor_rate[i]
    old = s.half_rotor_rate[i]
    trial = old + dt / p.rotor_inertia[i] * (motor - s.teeth_torque[i] - drag)
    friction = _sliding(p, i, p.rotor_coulomb[i], s.rotor_rate[i])
    friction += _gearbox(p, i, motor, trial)
    if s.locked[i]:
        friction += p.brake_torque[i]
    new = _slowed(trial, dt / p.rotor_inertia[i] * friction)
    mean = 0.5 * (old + new)
    s.rotor_acceleration[i] = (new - old) / dt
    s.half_rotor_rate[i] = new
    return mean, drag * s.rotor_rate[i] + _lost(s, p.rotor_inertia[i] * (trial - new) * mean, dt)


@inner
def _slide(s: Any, p: Any, dt: float) -> float:
    """The power (W) that cables lose which slip on their drums."""
    losses = 0.0
    for i in range(len(s.tension)):
        if s.elastic[i] > 0.0:
            s.wound += stored(p, i, s.elastic[i], dt * p.slip_rate[i])[1]
            losses += _lost(s, dt * s.tension[i] * p.slip_rate[i], dt)
    return losses


@inner
def kick_drums(s: Any, p: Any, dt: float, losses: float) -> float:
    """Change the rates of mid-step; returns ``losses`` (W) with those of the drums added.

    Friction and gearbox loss are solved implicitly: they slow a drum at most to a standstill, where
    they hold it with any torque up to their limit.
    """
    before = losses
    losses += s.teeth_dissipation
    copper = 0.0
    for i in range(len(s.tension)):
        torque = p.torque_per_amp[i] * s.current[i]
        copper += p.resistance * s.current[i] * s.current[i]
        drag = p.viscous[i] * s.drum_rate[i]
        old = s.half_rate[i]
        friction = _sliding(
            p, i, p.coulomb[i] + p.load_friction[i] * p.radius[i] * s.tension[i], s.drum_rate[i]
        )
        if p.backlash > 0.0:
            mean, lost = _kick_rotor(s, p, i, torque, dt)
            s.input_work += dt * torque * mean
            losses += lost
            torque = s.teeth_torque[i]
        trial = old + dt / p.drum_inertia[i] * (torque - p.radius[i] * s.tension[i] - drag)
        if p.backlash == 0.0:
            friction += _gearbox(p, i, torque, trial)
            if s.locked[i]:
                friction += p.brake_torque[i]
        new = 0.0 if s.jammed[i] else _slowed(trial, dt / p.drum_inertia[i] * friction)
        mean = 0.5 * (old + new)
        losses += drag * s.drum_rate[i] + _lost(s, p.drum_inertia[i] * (trial - new) * mean, dt)
        if p.backlash == 0.0:
            s.input_work += dt * torque * mean
        if s.elastic[i] > 0.0:
            s.wound -= stored(p, i, s.elastic[i], dt * p.radius[i] * mean)[1]
        s.drum_acceleration[i] = (new - old) / dt
        s.half_rate[i] = new
    if p.slipping > 0.0:
        losses += _slide(s, p, dt)
    s.friction_losses += dt * (losses - before)
    s.copper_losses += dt * copper
    return losses


@inner
def drift_drums(s: Any, p: Any, dt: float) -> None:
    """Turn with the rates of mid-step."""
    for i in range(len(s.tension)):
        s.drum_angle[i] += dt * s.half_rate[i]
        if p.backlash > 0.0:
            s.rotor_angle[i] += dt * s.half_rotor_rate[i]
    if p.slipping > 0.0:
        for i in range(len(s.tension)):
            s.slipped[i] += dt * p.slip_rate[i]


@inner
def predict_drums(s: Any, p: Any, dt: float) -> None:
    """Rates ``dt`` after mid-step by the last torques. What friction holds is taken as held."""
    for i in range(len(s.tension)):
        rate = s.half_rate[i]
        s.drum_rate[i] = rate + dt * s.drum_acceleration[i] if rate != 0.0 else 0.0
        if p.backlash > 0.0:
            rate = s.half_rotor_rate[i]
            s.rotor_rate[i] = rate + dt * s.rotor_acceleration[i] if rate != 0.0 else 0.0
