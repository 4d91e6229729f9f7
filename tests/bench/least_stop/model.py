"""Platform, seven cables and seven drums as symbolic expressions: a third model of the robot,
written apart from the plant's and the controller's.

State (26,): position m, orientation as modified Rodrigues parameters (tan of a quarter of the
angle, along the axis), velocity m/s, body rate rad/s, cable reeled in since the break m (7,), its
rate m/s (7,). Control (7,): what gearbox and friction leave of each motor's torque, as N at the
cable. A push: a force in the base frame, N (3,), on a point of the platform.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.lab import Lab
from tonus.config.schema.robot import Robot

Array = NDArray[np.float64]
LEFT = 7
"""cables that are left"""
BODY = 12
"""states of the platform alone"""
STATES = BODY + 2 * LEFT
GEOMETRY = 7 * LEFT + 3
"""numbers of a case's geometry, the point that is pushed included"""
_KINK = 2.0
"""N: width over which a cable's slack and the table's touch are rounded"""
_FRICTION_TENSION = 80.0
"""N: at which friction is taken from the motors' force"""
_TABLE_STIFFNESS = 5.0e3
"""N/m: soft enough for the steps of the late phase"""
_TABLE_DAMPING = 0.5
"""s/m: share of the table's force per m/s of sinking (Hunt and Crossley)"""


@dataclass(frozen=True)
class Constants:
    """Numbers of the robot that no case changes; SI, drums and motors as seen at the cable."""

    mass: float
    inertia: tuple[float, float, float]
    gravity: float
    axial_stiffness: float
    damping: float
    drum_mass: float
    viscous: float
    friction: float
    """N: Coulomb and load friction of a drum at `_FRICTION_TENSION`"""
    efficiency: float
    motor_force: float
    """N at the cable without losses, at the current limit"""
    reel_limit: float
    """m/s of cable at which the supply drives just the current limit"""
    table_height: float
    """m, of the platform's origin where it lies"""

    @staticmethod
    def of(robot: Robot, lab: Lab) -> Constants:
        drum, motor = robot.drum, robot.motor
        radius, ratio = drum.radius, robot.gearbox.ratio
        drop = lab.plant.winding_resistance * motor.current_limit
        return Constants(
            robot.platform.mass,
            robot.platform.inertia,
            robot.gravity,
            robot.cable.axial_stiffness,
            robot.cable.damping,
            drum.inertia / radius**2,
            drum.viscous_friction / radius**2,
            lab.plant.coulomb_friction + lab.plant.load_friction * _FRICTION_TENSION,
            robot.gearbox.efficiency if lab.plant.gearbox_losses else 1.0,
            motor.current_limit * motor.torque_constant * ratio / radius,
            (lab.drive.supply - drop) / motor.torque_constant / ratio * radius,
            robot.rest[2],
        )

    @property
    def driving_force(self) -> float:
        """N at the cable: what a motor at the current limit leaves of its torque when it drives a
        drum, viscous friction apart. Braking one it has more, which is left out here."""
        return self.efficiency * self.motor_force - self.friction


def _rotation(s: ca.SX) -> ca.SX:
    """Platform to base."""
    k = ca.skew(s)
    square = ca.dot(s, s)
    return ca.SX.eye(3) + (8.0 * k @ k + 4.0 * (1.0 - square) * k) / (1.0 + square) ** 2


def _rounded(x: ca.SX) -> ca.SX:
    """max(0, x), rounded."""
    return 0.5 * (x + ca.sqrt(x * x + _KINK**2))


class Model:
    """CasADi functions of state x, control u, push f and a case's geometry ``g`` (52,): anchors in
    the base frame (7, 3) and in the platform frame (7, 3), unstretched lengths at the break (7,),
    and the point of the platform that is pushed (3,).

    ``motion``: rate of change of state, and tensions (33,). ``body_motion``: that of the platform
    alone (12,) under given tensions. ``*_slopes``: their derivatives.
    """

    def __init__(self, c: Constants) -> None:
        self.constants = c
        x, u, f = ca.SX.sym("x", STATES), ca.SX.sym("u", LEFT), ca.SX.sym("f", 3)
        g = ca.SX.sym("g", GEOMETRY)
        body, reeled, reeling = x[:BODY], x[BODY : BODY + LEFT], x[BODY + LEFT :]
        free = g[6 * LEFT : 7 * LEFT] - reeled
        courses = [_course(body, g, i) for i in range(LEFT)]
        tensions = []
        for i, (length, _, _, shortening) in enumerate(courses):
            elastic = _rounded(c.axial_stiffness * (length - free[i]) / free[i])
            # The damper's share fades with the stretch, so that a cable never pushes.
            rate = reeling[i] - shortening
            tensions.append(elastic * (1.0 + c.damping * rate / (elastic + c.damping)))
        pull = ca.vertcat(*tensions)
        given = ca.SX.sym("given", LEFT)
        pushed = f, g[7 * LEFT :]
        under_given = _body_rates(c, body, courses, given, pushed)
        drums = (u - pull) / c.drum_mass
        rates = ca.vertcat(_body_rates(c, body, courses, pull, pushed), reeling, drums)
        every = ca.vertcat(rates, pull)
        both = ca.vertcat(body, given)
        inputs, body_inputs = [x, u, f, g], [body, given, f, g]
        self.derivative = ca.Function("derivative", inputs, [rates])
        self.tension = ca.Function("tension", [x, g], [pull])
        self.motion = ca.Function("motion", inputs, [every])
        self.slopes = ca.Function("slopes", inputs, [ca.jacobian(every, ca.vertcat(x, u))])
        self.body_motion = ca.Function("body_motion", body_inputs, [under_given])
        self.body_slopes = ca.Function("body_slopes", body_inputs, [ca.jacobian(under_given, both)])


def _course(body: ca.SX, g: ca.SX, i: int) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Of a cable: length, direction in the base frame, lever in the platform frame, and the speed
    at which the platform shortens it."""
    anchor, tip = g[3 * i : 3 * i + 3], g[3 * (LEFT + i) : 3 * (LEFT + i) + 3]
    rotation = _rotation(body[3:6])
    way = anchor - body[0:3] - rotation @ tip
    length = ca.norm_2(way)
    direction = way / length
    speed = body[6:9] + rotation @ ca.cross(body[9:12], tip)
    return length, direction, tip, ca.dot(direction, speed)


def _body_rates(
    c: Constants,
    body: ca.SX,
    courses: list[tuple[ca.SX, ca.SX, ca.SX, ca.SX]],
    pull: ca.SX,
    pushed: tuple[ca.SX, ca.SX],
) -> ca.SX:
    """Newton, Euler and the kinematics of the orientation (12,)."""
    turn, velocity, rate = body[3:6], body[6:9], body[9:12]
    rotation = _rotation(turn)
    push, point = pushed
    force, moment = ca.SX(push), ca.cross(point, rotation.T @ push)
    for i, (_, direction, tip, _) in enumerate(courses):
        force += pull[i] * direction
        moment += ca.cross(tip, rotation.T @ direction) * pull[i]
    # At rest the platform's origin lies at the table's height; the spring begins above it.
    begin = c.table_height + c.mass * c.gravity / _TABLE_STIFFNESS
    touch = _rounded(_TABLE_STIFFNESS * (begin - body[2]))
    force[2] += touch * (1.0 - _TABLE_DAMPING * velocity[2]) - c.mass * c.gravity
    inertia = ca.DM(c.inertia)
    square = ca.dot(turn, turn)
    turning = (1.0 - square) * rate + 2.0 * ca.cross(turn, rate) + 2.0 * turn * ca.dot(turn, rate)
    spin = (moment - ca.cross(rate, inertia * rate)) / inertia
    return ca.vertcat(velocity, 0.25 * turning, force / c.mass, spin)


def rodrigues(quaternion: Array) -> Array:
    """Modified Rodrigues parameters (3,) of a unit quaternion, scalar first."""
    q = quaternion if quaternion[0] >= 0.0 else -quaternion
    return np.asarray(q[1:] / (1.0 + q[0]))
