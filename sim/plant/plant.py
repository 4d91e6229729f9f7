"""The robot's mechanics behind the emulated devices: motors' currents in, motion and forces out."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.config.schema.lab import Displacement, Lab, Load, Phantom
from tonus.config.schema.robot import Robot
from tonus.sim.lab.truth import truth_dtype
from tonus.sim.plant import kernel
from tonus.sim.plant.defects import Defects
from tonus.sim.plant.energy import Energy
from tonus.sim.plant.layout import state_dtype
from tonus.sim.plant.parameters import add_load, add_phantom, let_go, parameters, strain, take_hold
from tonus.sim.plant.streams import Stream, generator

Floats = NDArray[np.float64]


class Plant:
    """Platform, cables, drums and currents, at first at rest in the cradle with the cables slack.

    Arrays are live views, valid after `advance`; the drives write ``current_reference`` (A; it has
    the motor's own sign, like all that is named after the motor), ``powered`` and ``locked``. Equal
    seeds and equal calls of `advance` give equal bytes; other instants to stop at give the same
    motion within the integrator's error.

    ``phantom``, ``load`` and ``displacement`` are what the present scenario has, or None;
    ``start_ns`` is the time on the lab's clock at which the plant begins.
    """

    def __init__(
        self,
        robot: Robot,
        lab: Lab,
        *,
        seed: int,
        phantom: Phantom | None,
        load: Load | None,
        displacement: Displacement | None = None,
        start_ns: int = 0,
    ) -> None:
        seed = lab.robot_seeded(seed)
        random = generator(seed, Stream.PLANT)
        anchors = np.array(robot.geometry.frame, dtype=np.float64)
        anchors += lab.plant.anchor_sigma * random.standard_normal(anchors.shape)
        self.parameters = parameters(robot, lab, anchors, generator(seed, Stream.MISMATCH))
        """one record of `layout.parameters_dtype`: the true robot, mismatch included"""
        if phantom is not None:
            add_phantom(self.parameters, phantom)
        self._knots = np.zeros(0)
        self._loads = np.zeros(0)
        self._displacement = displacement
        if load is not None:
            self.schedule(load)
        self.state = np.zeros(1, state_dtype(robot.cables))
        state = self.state
        true = truth_dtype(robot.cables).itemsize
        self.truth: Floats = state.view(np.uint8)[:true].view(np.float64)
        """the state's first part, in the order of `tonus.sim.lab.truth.TRUTH_TABLE`"""
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
        self.motor_current: Floats = state["motor_current"][0]
        self.current_reference: Floats = state["current_reference"][0]
        self.cell_force: Floats = state["cell_force"][0]
        self.load_wrench: Floats = state["load"][0]
        self.cut: Floats = state["cut"][0]
        self.contact_force: Floats = state["contact_force"].reshape(())
        self.contact_penetration: Floats = state["contact_penetration"].reshape(())
        self.losses: Floats = state["losses"].reshape(())
        self.platform_power: Floats = state["platform_power"].reshape(())
        self.electrical_power: Floats = state["electrical_power"].reshape(())
        self.powered: NDArray[np.bool_] = state["powered"][0].view(np.bool_)
        self.locked: NDArray[np.bool_] = state["locked"][0].view(np.bool_)
        self.now_ns = start_ns
        self._schedule_ns: int | None = None
        self.defects = Defects(state, self.parameters, lambda: self.now_ns)
        """what can be broken about it on purpose"""
        self._substep_ns = lab.plant.substep_us * 1000
        self.position[:] = robot.rest
        self.quaternion[0] = 1.0
        self._rest = robot.rest
        self._slack = random.uniform(*lab.plant.slack_at_start, size=robot.cables)
        """m (n,) of each cable at the start"""
        self.parameters["start_length"] = self.cable_lengths() + self._slack
        self._run(0, 0.0, -inf)

    def advance(self, to_ns: int) -> None:
        """Let time pass up to ``to_ns``, in equal steps no longer than the configured one."""
        courses = self.defects.courses
        while to_ns > self.now_ns:
            until_ns = self.defects.prepare(self.now_ns, to_ns) if courses else to_ns
            span = until_ns - self.now_ns
            steps = -(-span // self._substep_ns)
            begun = -inf if self._schedule_ns is None else (self.now_ns - self._schedule_ns) * 1e-9
            if self._displacement is not None:
                self._grip(self._displacement, begun)
            self._run(steps, span * 1e-9 / steps, begun)
            self.now_ns = until_ns
            if courses:
                self.defects.finish(until_ns)

    def _run(self, steps: int, dt: float, time: float) -> None:
        kernel.advance(self.state, self.parameters, self._knots, self._loads, steps, dt, time)

    def _grip(self, displacement: Displacement, time: float) -> None:
        """Take hold at the first point of a displacement's profile, let go after the last."""
        profile = displacement.profile
        if not self._knots.size and profile[0].at <= time <= profile[-1].at:
            self._knots = np.array([point.at for point in profile])
            self._loads = np.array([point.distance for point in profile])
            take_hold(self.parameters, displacement, self.position)
        elif self._knots.size and time > profile[-1].at:
            self._knots, self._loads = np.zeros(0), np.zeros(0)
            let_go(self.parameters)

    def add_phantom(self, phantom: Phantom) -> None:
        """Put one where there is none, and where the contact port has not been."""
        add_phantom(self.parameters, phantom)

    def schedule(self, load: Load) -> None:
        """Have the load port play ``load``. Raises `ValueError` for a profile that runs back."""
        self._knots = np.array([point.at for point in load.profile])
        self._loads = np.array([point.force for point in load.profile])
        if np.any(np.diff(self._knots) < 0.0):
            raise ValueError("the load's profile must run forward in time")
        add_load(self.parameters, load)

    def start_schedule(self, at_ns: int) -> None:
        """Time zero of the load's profile."""
        self._schedule_ns = at_ns

    def release(self, rate: float) -> None:
        """Let the load's force go to zero at ``rate`` (N/s) from now on, whatever its profile says;
        a displacement lets go at once."""
        if self._displacement is not None:
            self._displacement = None
            let_go(self.parameters)
        elif self._schedule_ns is not None and self._knots.size:
            now, force = self._scheduled(self._schedule_ns)
            self._knots = np.array([now, now + abs(force) / rate])
            self._loads = np.array([force, 0.0])
            return
        self._knots, self._loads = np.zeros(0), np.zeros(0)

    def withhold(self) -> None:
        """Let a load that does not pull now pull no more."""
        if self._schedule_ns is not None and self._knots.size:
            _, force = self._scheduled(self._schedule_ns)
            if force == 0.0:
                self._knots, self._loads = np.zeros(0), np.zeros(0)

    def _scheduled(self, begun_ns: int) -> tuple[float, float]:
        """s of the load's profile, and its force."""
        now = (self.now_ns - begun_ns) * 1e-9
        return now, float(np.interp(now, self._knots, self._loads))

    @property
    def has_phantom(self) -> bool:
        return bool(self.parameters["contact"][0] > 0.0)

    def energy(self) -> Energy:
        state = self.state[0]
        return Energy(**{name: float(state[name]) for name in Energy.__dataclass_fields__})

    def _at_rest(self) -> Any:
        """A copy of the state's record, at rest, with the geometry of the present pose."""
        trial = self.state.copy()
        kernel.static_wrench(trial, self.parameters, False)
        return trial[0]

    def cable_lengths(self) -> Floats:
        """m (n,): from each frame anchor, round the pulley if there is one, to the platform's."""
        return np.array(self._at_rest()["length"])

    def structure_matrix(self) -> Floats:
        """W (6, n) of the present pose: the cables' wrench about the platform origin is W T."""
        still = self._at_rest()
        return np.vstack([still["direction"].T, np.cross(still["lever"], still["direction"]).T])

    def wrench(
        self,
        position: Sequence[float] | Floats,
        quaternion: Sequence[float] | Floats,
        tensions: Sequence[float] | Floats | None = None,
    ) -> Floats:
        """Total wrench (6,) on the platform at rest at a pose, about its origin: cables, weight,
        phantom and cradle, without the load port. Nothing moves and no state changes.

        With ``tensions`` (n,) the cables pull with just these; without, each pulls as its
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
        self.state["standing"] = 0.0
        p = self.parameters[0]
        pull = np.asarray(tensions, dtype=np.float64)
        free = self.cable_lengths() / (1.0 + strain(self.parameters, pull))
        free -= self.state["slipped"][0]
        self.drum_angle[:] = (p["start_length"] - free) / p["radius"]
        twist = np.where(
            pull > 0.0, p["half_play"] + pull * p["radius"] / p["teeth_stiffness"], 0.0
        )
        self.state["rotor_angle"][0] = self.drum_angle + twist
        self.state["rotor_rate"] = 0.0
        self.current[:] = pull * p["radius"] / p["torque_per_amp"]
        self.current_reference[:] = p["sign"] * self.current
        self.state["cell_filtered"][0, :-1] = pull
        self.powered[:] = True
        self._run(0, 0.0, -inf)

    def put_back(self) -> None:
        """Put the platform into its cradle, with the drums turned so that every cable is as slack
        as at the start; a person's work, which is in no account of energy. Power stays."""
        state, p = self.state, self.parameters[0]
        self.position[:] = self._rest
        self.quaternion[:] = (1.0, 0.0, 0.0, 0.0)
        for name in ("velocity", "angular_velocity", "drum_rate", "rotor_rate", "standing"):
            state[name] = 0.0
        free = self.cable_lengths() + self._slack - state["slipped"][0]
        self.drum_angle[:] = (p["start_length"] - free) / p["radius"]
        state["rotor_angle"][0] = self.drum_angle
        self._run(0, 0.0, -inf)

    def cut_cable(self, cable: int) -> None:
        """Break a cable: it never pulls again, and its strain energy is lost."""
        state, p = self.state[0], self.parameters[0]
        if p["axial_stiffness"][cable] == 0.0:
            return
        state["losses"] += state["stored"][cable]
        p["axial_stiffness"][cable] = 0.0
        state["cut"][cable] = 1.0
        self._run(0, 0.0, -inf)
