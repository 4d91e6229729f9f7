"""The control cycle closed on the plant without a bus: the shortest loop that still has the real
delays and the devices' quantisation.

In tick k the cycle reads what was sampled in tick k-1, and what it commands acts at the sampling
instant of tick k+1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonus.config import load
from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Reference, Scenario
from tonus.drivers.process_image import AxisCommand, AxisState, ProcessImage
from tonus.runtime.control.tuning import NO_CHANGE, GainChange
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.operation.operator import Script
from tonus.runtime.signals import TABLE
from tonus.runtime.states import Operator, State
from tonus.sim.devices.tracker import DATAGRAM, VALID, Tracker
from tonus.sim.lab.truth import truth_dtype
from tonus.sim.plant import Plant

Array = NDArray[np.float64]
SAMPLE_OFFSET_NS = 50_000
"""from the start of a tick to the devices' sampling instant"""
QUICK: dict[str, Any] = {
    "control.sequence.tare_s": 0.05,
    "control.sequence.referencing_settle_s": 0.6,
    "control.sequence.referencing_average_s": 0.25,
    "control.sequence.pretension_s": 0.4,
    "control.sequence.lift_s": 1.0,
    "supervisor.policy": "off",
}
"""Overrides that bring the robot up in half the time, for tests of what comes after. The cells are
tared for so short that a supervisor would not begin."""


def configured(scenario: str, overrides: dict[str, Any] | None = None) -> tuple[Config, Scenario]:
    """The shipped robot with a scenario and dotted overrides."""
    return load("config/can.yaml", scenario=scenario, overrides=overrides)


@dataclass(frozen=True)
class Inputs:
    """What the cycle was given in one tick, enough to give it again."""

    axes: NDArray[np.void]
    cells: NDArray[np.void]
    tracker: NDArray[np.void]
    operator: Operator


@dataclass(frozen=True)
class Trace:
    """A run: cycle record and truth of every tick."""

    cycle: NDArray[np.void]
    truth: NDArray[np.void]

    @property
    def state(self) -> NDArray[np.uint8]:
        return np.asarray(self.cycle["state"]["state"])

    def during(self, state: State, *, after: float = 0.0) -> Trace:
        """The ticks in a state, from ``after`` s in it."""
        chosen = (self.state == state) & (self.cycle["state"]["elapsed"] >= after)
        assert chosen.any(), f"the run never was in {state.name} for {after} s"
        return Trace(self.cycle[chosen], self.truth[chosen])


class ClosedLoop:
    """One robot in one scenario; `tick` is a millisecond.

    A test may silence ``axes`` and ``cells`` (their ages then grow), block the tracker, or put a
    device's own ``axis_state`` in place of the obedient one (negative: obedient). ``others`` are
    references that a tick may select, by their numbers from 2 on.
    """

    def __init__(
        self,
        config: Config,
        scenario: Scenario,
        *,
        seed: int | None = None,
        others: Iterable[Reference] = (),
    ) -> None:
        robot, lab = config.robot, config.lab
        assert lab is not None
        self.scenario = scenario
        seed = lab.seed if seed is None else seed
        script = scenario.lab
        self.plant = Plant(
            robot,
            lab,
            seed=seed,
            phantom=script.phantom or lab.phantom,
            load=script.load,
            displacement=script.displacement,
        )
        self.tracker = Tracker(
            config.tracker, lab.noise.tracker, self.plant, seed, lab.robot_seeded(seed)
        )
        self.cycle = ControlCycle(
            robot,
            config.control,
            config.tracker,
            scenario.reference,
            others,
            config.operation.tunable,
        )
        self.image = ProcessImage(robot.cables)
        self.silent_axes: set[int] = set()
        self.silent_cells: set[int] = set()
        self.axis_state = np.full(len(self.image.axes), -1)
        self.number = 0
        self.inputs: list[Inputs] = []
        self.keep_inputs = False
        self.late_ns = self._sampled_ns = self._sampled_tick = 0
        """by how much the next tick's SYNC goes out late, as a host has it"""
        self._cycles: list[bytes] = []
        self._truths: list[Array] = []
        self._period_ns = config.control.rates.period_ns
        self._fresh_ticks = config.control.freshness.measurement_ticks
        self._random = np.random.default_rng([seed, robot.cells])
        noise = lab.noise.force_cell
        self._offset = self._random.normal(0.0, noise.offset_sigma, robot.cells)
        self._sigma = noise.sigma
        digits = config.fieldbus.force_cell.decimal_digits
        self._cell_grid = 10.0**-digits
        motors = [train.motor for train in robot.drive_trains]
        per_revolution = np.array([motor.increments_per_revolution for motor in motors])
        self._increments = per_revolution / (2.0 * np.pi)
        self._ratio = robot.gear_ratio * robot.signs
        self._rated = np.array([motor.rated_torque for motor in motors])
        self._torque_constant = np.array([motor.torque_constant for motor in motors])
        self._sample: tuple[Array, Array] | None = None
        self._enabled = np.zeros(len(self.image.axes), dtype=bool)
        self._current = np.zeros(len(self.image.axes))
        self._scheduled = False

    @property
    def state(self) -> State:
        return self.cycle.sequence.state

    @property
    def trace(self) -> Trace:
        truth = np.array(self._truths).view(truth_dtype(len(self.image.axes))).reshape(-1)
        cycle = np.frombuffer(bytearray().join(self._cycles), self.cycle.record.data.dtype)
        return Trace(cycle, truth)

    def forget(self) -> None:
        """Begin the trace anew, as before a stretch that is looked at by itself."""
        self._cycles.clear()
        self._truths.clear()

    def tick(
        self,
        operator: Operator = Operator.NONE,
        select: int = 0,
        change: GainChange = NO_CHANGE,
    ) -> None:
        now = self.number * self._period_ns
        while self.tracker.next_ns <= now + SAMPLE_OFFSET_NS:
            due = self.tracker.next_ns
            self.plant.advance(due)
            self.tracker.expose(due)
        self._collect(now)
        self._exchange(now)
        if self.keep_inputs:
            image = self.image
            self.inputs.append(
                Inputs(image.axes.copy(), image.cells.copy(), image.tracker.copy(), operator)
            )
        record = self.cycle.step(self.image, self.number, operator, select, change)
        self._cycles.append(record.data.tobytes())
        self._truths.append(self.plant.truth.copy())
        self._publish(now)
        self.number += 1

    def until(self, state: State, *, within: float = 10.0) -> None:
        """Arm and start as needed, and go on until the first tick in ``state``."""
        script = Script(self.scenario.duration)
        for _ in range(round(within * 1e9 / self._period_ns)):
            self.tick(script.next(self.cycle.sequence))
            if self.state is state:
                return
        raise AssertionError(f"{state.name} was not reached, but {self.state.name}")

    def run(self, seconds: float, each: Callable[[], None] = lambda: None) -> None:
        for _ in range(round(seconds * 1e9 / self._period_ns)):
            each()
            self.tick()

    def complete(self) -> Trace:
        """The whole scenario, to STANDBY or FAULT."""
        script = Script(self.scenario.duration)
        while not script.finished:
            self.tick(script.next(self.cycle.sequence))
        return self.trace

    def _collect(self, now: int) -> None:
        """Samples of the last tick reach the image."""
        axes, cells, tracker = self.image.axes, self.image.cells, self.image.tracker
        if self._sample is not None:
            for table, name, values, silent in (
                (axes, "angle", self._sample[0], self.silent_axes),
                (cells, "force", self._sample[1], self.silent_cells),
            ):
                heard = np.array([row not in silent for row in range(len(table))])
                table[name] = np.where(heard, values, table[name])
                age = self.number - self._sampled_tick - 1
                table["age"] = np.where(heard, age, np.minimum(table["age"], 60_000) + 1)
            told = np.where(
                self.image.commands["command"] == AxisCommand.ENABLE,
                AxisState.OPERATION_ENABLED,
                AxisState.SWITCH_ON_DISABLED,
            )
            told = np.where(self.axis_state >= 0, self.axis_state, told)
            axes["state"] = np.where(axes["age"] <= self._fresh_ticks, told, AxisState.LOST)
            axes["sampled_ns"] = self._sampled_ns
        tracker["fresh"] = 0
        for datagram in self.tracker.poll(now):
            _, _, _, sequence, flags, stamp, *pose, _ = DATAGRAM.unpack(datagram)
            if flags & VALID:
                tracker["fresh"], tracker["sequence"] = 1, sequence
                tracker["position"], tracker["quaternion"] = pose[:3], pose[3:]
                tracker["delay"] = (now - stamp) * 1e-9

    def _exchange(self, now: int) -> None:
        """Every device samples, then applies what the last tick commanded."""
        plant = self.plant
        plant.advance(now + self.late_ns + SAMPLE_OFFSET_NS)
        self._sampled_ns, self._sampled_tick = now + self.late_ns, self.number
        angle = np.floor(plant.motor_angle * self._increments) / self._increments / self._ratio
        force = (
            plant.cell_force
            + self._offset
            + self._random.normal(0.0, self._sigma, len(self._offset))
        )
        self._sample = (angle, np.round(force / self._cell_grid) * self._cell_grid)
        plant.current_reference[:] = self._current
        plant.powered[:] = self._enabled

    def _publish(self, now: int) -> None:
        commands = self.image.commands
        per_mille = np.round(commands["torque"] / self._ratio / self._rated * 1000.0)
        self._current = per_mille * self._rated / 1000.0 / self._torque_constant
        self._enabled = commands["command"] == AxisCommand.ENABLE
        if not self._scheduled and self._enabled.all():
            self._scheduled = True
            self.plant.start_schedule(now)


def contact_of(trace: Trace) -> Array:
    """True contact force, N."""
    return np.asarray(trace.truth["contact_force"])


def not_finite(records: NDArray[np.void]) -> list[str]:
    """Signals of cycle records that are somewhere not a finite number."""
    return [
        f"{topic.name}.{field.name}"
        for topic in TABLE
        for field in topic.fields
        if not np.isfinite(records[topic.name.rsplit("/", 1)[1]][field.name]).all()
    ]


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


__all__ = [
    "QUICK",
    "ClosedLoop",
    "Inputs",
    "Trace",
    "configured",
    "contact_of",
    "not_finite",
    "rms",
]
