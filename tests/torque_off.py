"""The drives' torque taken away: how far and how fast the platform falls, with holding brakes and
without, at rest and while it sinks at the speed at which the envelope begins to slow it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from math import pi
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np

from tests.loop import QUICK
from tonus.config import load
from tonus.config.schema.axis import Brake
from tonus.config.schema.robot_faults import BrakeWeak, SafeTorqueOff
from tonus.config.schema.scenario import Sine
from tonus.runtime.states import Operator, State
from tonus.tools.log import open as open_log
from tonus.tools.run.held import HeldRobot, HeldRun

Place = tuple[float, float, float]
Motion = Literal["rest", "sinking"]
MOTIONS: tuple[Motion, ...] = ("rest", "sinking")
PLACES: dict[str, Place] = {
    "centre": (0.0, 0.0, 0.0),
    "high": (0.0, 0.0, 0.15),
    "high, at the edge": (0.15, 0.15, 0.15),
}
"""m"""
CABLES = 8
_AMPLITUDE = 0.03
"""m, of the motion; a place is its middle"""
_STEP = 0.25
"""s between two looks at whether it is over"""
_LONGEST = 20.0
"""s; a passive stop may take 15"""
_STILL = 0.01
"""m/s and rad/s"""


@dataclass(frozen=True)
class Case:
    """Where and what. Axes count from 0."""

    place: str
    motion: Motion
    axis: int | None
    """whose torque is off; None: every one"""
    brakes: bool
    failed: int | None
    """axis whose brake does not hold"""


@dataclass(frozen=True)
class Fallen(Case):
    """What came of it, of the platform's origin and from the fault on."""

    speed_before: float
    """m/s"""
    drop: float
    """m, from the place of the fault to the lowest"""
    cradle: float
    """m, how much there was to the cradle"""
    peak_speed: float
    """m/s"""
    free_fall: float
    """s, the longest in which it fell with 0.8 g or more"""
    peak_tension: float
    """N"""
    seconds: float
    """to rest in FAULT"""
    state: str
    reason: str
    at_rest: bool


def cases(place: str, motion: Motion, *, brakes: bool) -> Iterator[Case]:
    """Every drive at once, each by itself, and with brakes each of these that fails."""
    yield Case(place, motion, None, brakes, None)
    for axis in range(CABLES):
        yield Case(place, motion, axis, brakes, None)
    for failed in range(CABLES) if brakes else ():
        yield Case(place, motion, None, brakes, failed)


def play(place: str, motion: Motion, brake: Brake | None, chosen: list[Case]) -> Iterator[Fallen]:
    """The cases of one place and motion, from one held robot."""
    overrides: dict[str, Any] = QUICK | {
        "robot.home": list(PLACES[place]),
        "control.sequence.lift_s": 3.0,
        "scenario": "sine_z",
    }
    if brake is not None:
        overrides["robot.brake"] = brake.model_dump()
    config, scenario = load("config/direct.yaml", overrides=overrides)
    envelope = config.control.envelope
    speed = envelope.speed_limit * envelope.speed_warning
    assert isinstance(scenario.reference, Sine)
    frequency = speed / (2.0 * pi * _AMPLITUDE)
    # It begins upwards and fades in within whole periods; its middle is passed downwards next.
    reference = scenario.reference.model_copy(
        update={"amplitude": _AMPLITUDE, "frequency": frequency, "fade": 1.0}
    )
    scenario = scenario.model_copy(update={"reference": reference, "duration": 10.0})
    with closing(HeldRobot(config, scenario)) as robot, TemporaryDirectory() as folder:
        for number, case in enumerate(chosen):
            out = Path(folder, str(number))
            with robot.operated(out) as run:
                began = _lead(run, motion, 0.95 * speed)
                before = run.seen.truth["velocity"][0].copy()
                if case.failed is not None:
                    run.inject(BrakeWeak(axis=case.failed, gain=0.0))
                run.inject(SafeTorqueOff(axis=case.axis))
                while run.seen.time - began < _LONGEST and not _over(run):
                    run.advance(_STEP)
                seconds, last = run.seen.time - began, run.seen
                still = _still(run)
            height = config.robot.rest[2]
            yield _judge(
                case, out / "run.mcap", began, float(np.linalg.norm(before)), height,
                seconds=round(seconds, 2), state=last.state.name, reason=last.fault, at_rest=still,
            )  # fmt: skip


def _lead(run: HeldRun, motion: Motion, speed: float) -> float:
    """Bring it into motion; returns the time (s) of now."""
    if motion == "sinking":
        run.command(Operator.START)
        run.advance(1.5)
        while float(run.seen.truth["velocity"][0, 2]) > -speed:
            run.advance(0.002)
            assert run.seen.time < 10.0, "it never sinks as fast as it should"
    return run.seen.time


def _still(run: HeldRun) -> bool:
    truth = run.seen.truth[0]
    rates = (truth["velocity"], truth["angular_velocity"])
    return bool(max(np.linalg.norm(rate) for rate in rates) < _STILL)


def _over(run: HeldRun) -> bool:
    return run.seen.state is State.FAULT and _still(run)


def _judge(
    case: Case, path: Path, began: float, before: float, cradle: float, **end: Any
) -> Fallen:
    log = open_log(path)
    truth = log["/tonus/truth"]
    first = round(began * 1000.0)
    height = truth["position"][first:, 2]
    velocity, tension = truth["velocity"][first:], truth["tension"][first:]
    falling = np.gradient(velocity[:, 2], 1e-3) < -0.8 * 9.80665
    return Fallen(
        **asdict(case),
        speed_before=round(before, 3),
        drop=round(float(height[0] - height.min()), 4),
        cradle=round(float(height[0] - cradle), 4),
        peak_speed=round(float(np.linalg.norm(velocity, axis=1).max()), 3),
        free_fall=round(1e-3 * _longest(falling.tolist()), 3),
        peak_tension=round(float(tension.max()), 1),
        **end,
    )


def _longest(flags: list[bool]) -> int:
    best = now = 0
    for flag in flags:
        now = now + 1 if flag else 0
        best = max(best, now)
    return best
