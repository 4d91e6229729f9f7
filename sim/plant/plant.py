"""The robot's mechanics behind the emulated devices: eight motors in, motion and forces out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from config.schema.lab import Lab, Load, Phantom
from config.schema.robot import CABLES, Robot
from sim.plant import kernel
from sim.plant.layout import PARAMETERS, STATE
from sim.plant.streams import Stream, generator
from sim.truth import TRUTH

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Energy:
    """The plant's energy accounts, all J.

    A free cable of unstretched length L0 stores E = EA stretch^2 / (2 L0), so that with T = EA
    stretch/L0

        dE = T dl - (T + T^2/(2 EA)) dL0,    dL0 = -r dtheta.

    The drum feels the torque r T (eq. 6), whose work is r T dtheta only. The difference,
    r T^2/(2 EA) dtheta, belongs to the cable wound on while strained; ``wound`` integrates its
    negative. ``total`` therefore changes by ``input_work + load_work - losses`` and nothing else,
    and ``balance`` is a constant of the motion.

    ``losses`` hold friction, gearbox, brake, cable and phantom damping and what the cradle takes
    sideways; copper losses are none of the mechanics'.
    """

    kinetic: float
    potential: float
    strain: float
    phantom: float
    cradle: float
    wound: float
    losses: float
    input_work: float
    load_work: float

    @property
    def total(self) -> float:
        stored = self.potential + self.strain + self.phantom + self.cradle
        return self.kinetic + stored + self.wound

    @property
    def balance(self) -> float:
        return self.total + self.losses - self.input_work - self.load_work


def _unit(vector: Sequence[float], what: str) -> Floats:
    direction = np.array(vector, dtype=np.float64)
    length = float(np.linalg.norm(direction))
    if length == 0.0:
        raise ValueError(f"{what} has no direction")
    return direction / length


def _parameters(robot: Robot, lab: Lab, anchors: Floats) -> NDArray[Any]:
    record = np.zeros(1, PARAMETERS)
    plant, cradle = lab.plant, lab.cradle
    weight = robot.platform.mass * plant.mass_scale * robot.gravity
    # Driven backwards, a gearbox of efficiency eta holds the cable with motor torque / eta.
    efficiency = robot.gearbox.efficiency if plant.gearbox_losses else 1.0
    values = {
        "mass": robot.platform.mass * plant.mass_scale,
        "inertia": np.array(robot.platform.inertia) * plant.mass_scale,
        "gravity": robot.gravity,
        "anchors": anchors,
        "tips": robot.geometry.platform,
        "axial_stiffness": robot.cable.axial_stiffness * plant.stiffness_scale,
        "cable_damping": robot.cable.damping,
        "radius": robot.drum.radius,
        "drum_inertia": robot.drum.inertia,
        "viscous": robot.drum.viscous_friction,
        "coulomb": plant.coulomb_friction * robot.drum.radius,
        "load_friction": plant.load_friction,
        "driving_loss": 1.0 - efficiency,
        "driven_loss": 1.0 / efficiency - 1.0,
        "torque_per_amp": robot.motor.torque_constant * robot.gearbox.ratio,
        "ratio": robot.gearbox.ratio,
        "current_limit": robot.motor.current_limit,
        "current_pole": 2.0 * pi * plant.current_loop_hz,
        "cell_pole": 2.0 * pi * lab.noise.force_cell.bandwidth_hz,
        # The spring begins so high that the platform lies at `rest` exactly.
        "cradle_height": robot.rest[2] + weight / cradle.stiffness,
        "cradle_place": robot.rest,
        "cradle_stiffness": cradle.stiffness,
        "cradle_damping": cradle.damping,
        "cradle_rotational_stiffness": cradle.rotational_stiffness,
        "cradle_rotational_damping": cradle.rotational_damping,
        "opening": 0.5,
    }
    for name, value in values.items():
        record[name] = value
    return record


def _add_phantom(record: NDArray[Any], phantom: Phantom) -> None:
    solid = phantom.model == "standard_linear_solid"
    record["contact"] = 1.0
    record["contact_point"] = phantom.point
    record["contact_normal"] = _unit(phantom.normal, "the phantom's normal")
    record["contact_stiffness"] = phantom.stiffness
    record["contact_damping"] = 0.0 if solid else phantom.damping
    record["relaxing_stiffness"] = phantom.relaxing_stiffness if solid else 0.0
    record["relaxation_rate"] = 1.0 / phantom.relaxation_time


class Plant:
    """Platform, cables, drums and currents, at first at rest in the cradle with the cables slack.

    Arrays are live views, valid after `advance`; the drives write ``current_reference`` (A),
    ``powered`` and ``locked``. Equal seeds and equal calls of `advance` give equal bytes; other
    instants to stop at give the same motion within the integrator's error.

    ``phantom`` and ``load`` are what the present scenario has, or None; ``start_ns`` is the time on
    the lab's clock at which the plant begins.
    """

    def __init__(
        self,
        robot: Robot,
        lab: Lab,
        *,
        seed: int,
        phantom: Phantom | None,
        load: Load | None,
        start_ns: int = 0,
    ) -> None:
        random = generator(seed, Stream.PLANT)
        anchors = np.array(robot.geometry.frame, dtype=np.float64)
        anchors += lab.plant.anchor_sigma * random.standard_normal(anchors.shape)
        self.parameters = _parameters(robot, lab, anchors)
        """one record of `layout.PARAMETERS`: the true robot, mismatch included"""
        if phantom is not None:
            _add_phantom(self.parameters, phantom)
        self._knots = np.zeros(0)
        self._loads = np.zeros(0)
        if load is not None:
            self._knots = np.array([point.at for point in load.profile])
            self._loads = np.array([point.force for point in load.profile])
            if np.any(np.diff(self._knots) < 0.0):
                raise ValueError("the load's profile must run forward in time")
            self.parameters["load_direction"] = _unit(load.direction, "the load")
            self.parameters["load_point"] = load.point
        self.state = np.zeros(1, STATE)
        state = self.state
        self.truth: Floats = state.view(np.float64).reshape(-1)[: TRUTH.itemsize // 8]
        """the state's first part, in the order of `sim.truth.TRUTH_FIELDS`"""
        self.position: Floats = state["position"][0]
        self.quaternion: Floats = state["quaternion"][0]
        self.velocity: Floats = state["velocity"][0]
        self.angular_velocity: Floats = state["angular_velocity"][0]
        self.tension: Floats = state["tension"][0]
        self.drum_angle: Floats = state["drum_angle"][0]
        self.drum_rate: Floats = state["drum_rate"][0]
        self.motor_angle: Floats = state["motor_angle"][0]
        self.motor_rate: Floats = state["motor_rate"][0]
        self.current: Floats = state["current"][0]
        self.current_reference: Floats = state["current_reference"][0]
        self.cell_force: Floats = state["cell_force"][0]
        self.load_wrench: Floats = state["load"][0]
        self.contact_force: Floats = state["contact_force"].reshape(())
        self.contact_penetration: Floats = state["contact_penetration"].reshape(())
        self.losses: Floats = state["losses"].reshape(())
        self.powered: NDArray[np.bool_] = state["powered"][0].view(np.bool_)
        self.locked: NDArray[np.bool_] = state["locked"][0].view(np.bool_)
        self.now_ns = start_ns
        self._schedule_ns: int | None = None
        self._substep_ns = lab.plant.substep_us * 1000
        self.position[:] = robot.rest
        self.quaternion[0] = 1.0
        slack = random.uniform(*lab.plant.slack_at_start, size=CABLES)
        self.parameters["start_length"] = self._vectors()[1] + slack
        self._run(0, 0.0, -inf)

    def advance(self, to_ns: int) -> None:
        """Let time pass up to ``to_ns``, in equal steps no longer than the configured one."""
        span = to_ns - self.now_ns
        if span <= 0:
            return
        steps = -(-span // self._substep_ns)
        begun = -inf if self._schedule_ns is None else (self.now_ns - self._schedule_ns) * 1e-9
        self._run(steps, span * 1e-9 / steps, begun)
        self.now_ns = to_ns

    def _run(self, steps: int, dt: float, time: float) -> None:
        kernel.advance(self.state, self.parameters, self._knots, self._loads, steps, dt, time)

    def start_schedule(self, at_ns: int) -> None:
        """Time zero of the load's profile."""
        self._schedule_ns = at_ns

    def energy(self) -> Energy:
        state = self.state[0]
        return Energy(**{name: float(state[name]) for name in Energy.__dataclass_fields__})

    def _vectors(self) -> tuple[Floats, Floats, Floats]:
        """Levers r_i (8, 3) in the base frame, cable lengths (8,), unit vectors u_i (8, 3)."""
        w, x, y, z = self.quaternion
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        levers = self.parameters["tips"][0] @ rotation.T
        cables = self.parameters["anchors"][0] - self.position - levers
        lengths = np.linalg.norm(cables, axis=1)
        return levers, lengths, cables / lengths[:, None]

    def structure_matrix(self) -> Floats:
        """W (6, 8) of the present pose: the cables' wrench about the platform origin is W T."""
        levers, _, units = self._vectors()
        return np.vstack([units.T, np.cross(levers, units).T])

    def wrench(
        self,
        position: Sequence[float] | Floats,
        quaternion: Sequence[float] | Floats,
        tensions: Sequence[float] | Floats | None = None,
    ) -> Floats:
        """Total wrench (6,) on the platform at rest at a pose, about its origin: cables, weight,
        phantom and cradle, without the load port. Nothing moves and no state changes.

        With ``tensions`` (8,) the cables pull with just these; without, each pulls as its
        elasticity has it with the drums where they are.
        """
        trial = self.state.copy()
        trial["position"][0] = position
        trial["quaternion"][0] = quaternion
        if tensions is not None:
            trial["tension"][0] = tensions
        kernel.static_wrench(trial, self.parameters, tensions is not None)
        return np.concatenate([trial["force"][0], trial["moment"][0]])

    def place(
        self,
        position: Sequence[float] | Floats,
        quaternion: Sequence[float] | Floats,
        tensions: Sequence[float] | Floats,
    ) -> None:
        """Put the platform to rest at a pose, with the drums turned so that every cable has its
        tension, and the motors powered with the current that balances it, losses aside."""
        self.position[:] = position
        self.quaternion[:] = np.asarray(quaternion) / np.linalg.norm(quaternion)
        self.velocity[:] = 0.0
        self.angular_velocity[:] = 0.0
        self.drum_rate[:] = 0.0
        p = self.parameters[0]
        pull = np.asarray(tensions, dtype=np.float64)
        free = self._vectors()[1] / (1.0 + pull / p["axial_stiffness"])
        self.drum_angle[:] = (p["start_length"] - free) / p["radius"]
        self.current[:] = pull * p["radius"] / p["torque_per_amp"]
        self.current_reference[:] = self.current
        self.cell_force[:CABLES] = pull
        self.powered[:] = True
        self._run(0, 0.0, -inf)

    def cut_cable(self, cable: int) -> None:
        """Break a cable: it never pulls again, and its strain energy is lost."""
        state, p = self.state[0], self.parameters[0]
        if p["axial_stiffness"][cable] == 0.0:
            return
        tension, free = state["elastic"][cable], state["strain_length"][cable]
        state["losses"] += 0.5 * tension**2 * free / p["axial_stiffness"][cable]
        p["axial_stiffness"][cable] = 0.0
        self._run(0, 0.0, -inf)
