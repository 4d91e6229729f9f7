"""The rigid body and the cables against MuJoCo, which shares no line with the plant.

The same robot as a free body on eight spatial tendons, the drums being lengths. A tendon's spring
with ``springlength="0 L0"`` pulls beyond L0 and never pushes, as the plant's cables do; its damper
also acts on a slack tendon, where the plant's does not, so damping is compared in a motion whose
cables stay taut. MuJoCo's fourth-order integrator at 50 us is as good as exact beside the plant's
second order at 250 us: what may differ is the plant's own error, and how large that is the plant
says itself, when its step is halved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from unit.plant_setup import (
    LAB,
    ROBOT,
    TICK_NS,
    balanced,
    frictionless,
    plant,
    undamped,
    with_plant,
    without_cradle,
)

from tonus.config.schema.lab import Load
from tonus.sim.plant import Plant

mujoco: Any = pytest.importorskip("mujoco")

Floats = NDArray[np.float64]
STEP = 5e-5
POSE = 2e-4
"""m, and parts of the quaternion"""
TENSION = 0.5
"""N; beyond these a motion is too rough to be compared at the configured step"""
WOUND = np.array([1.0, 0.0, 0.5, 0.0, 0.0, -0.5, 0.0, 0.0])
"""of `Motion.wind` by each drum"""


def sites(points: tuple[tuple[float, ...], ...], name: str) -> str:
    return "".join(
        f'<site name="{name}{i}" pos="{" ".join(map(repr, point))}"/>'
        for i, point in enumerate(points)
    )


def model(p: Plant, damping: float) -> Any:
    """The plant's robot with its drums where they are."""
    free = unstretched(p)
    tendons = "".join(
        f'<spatial stiffness="{ROBOT.cable.axial_stiffness / length!r}" damping="{damping}"'
        f' springlength="0 {length!r}"><site site="frame{i}"/><site site="tip{i}"/></spatial>'
        for i, length in enumerate(map(float, free))
    )
    body = ROBOT.platform
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco>
        <option gravity="0 0 {-ROBOT.gravity}" timestep="{STEP}" integrator="RK4">
          <flag contact="disable"/>
        </option>
        <worldbody>{sites(ROBOT.geometry.frame, "frame")}
          <body name="platform"><freejoint/>
            <inertial pos="0 0 0" mass="{body.mass}"
                      diaginertia="{" ".join(map(repr, body.inertia))}"/>
            {sites(ROBOT.geometry.platform, "tip")}
          </body>
        </worldbody>
        <tendon>{tendons}</tendon></mujoco>"""
    )


def unstretched(p: Plant) -> Floats:
    return np.array(p.parameters["start_length"][0] - ROBOT.drum.radius * p.drum_angle)


@dataclass(frozen=True)
class Motion:
    begin: Callable[[Plant], None]
    """from a plant balanced at the centre, drums held"""
    seconds: float
    slack: bool = False
    """some cables do not pull for a time"""
    damped: bool = False
    load: Load | None = None
    wind: float = 0.0
    """m of amplitude by which drums wind cable in and out at 2 Hz, in a jump each tick"""


def fall(p: Plant) -> None:
    """All cables a little slack: the platform drops into the upper ones and bounces on them."""
    p.place((0.01, 0.0, 0.03), (1.0, 0.0, 0.0, 0.0), np.full(8, 1e-6))
    p.drum_angle -= 0.01 / ROBOT.drum.radius


def release(p: Plant) -> None:
    """Let go off-centre, tilted and turning."""
    p.position[:] = (0.02, -0.015, 0.01)
    p.quaternion[:] = np.array([0.99, 0.08, -0.06, 0.09]) / np.linalg.norm(
        [0.99, 0.08, -0.06, 0.09]
    )
    p.angular_velocity[:] = (1.5, -2.0, 1.0)


def release_gently(p: Plant) -> None:
    p.position[:] = (0.004, -0.003, 0.003)
    p.angular_velocity[:] = (0.4, -0.5, 0.4)


def stay(p: Plant) -> None:
    """Nothing but what comes from outside."""


PUSH = Load.model_validate(
    {
        "direction": (0.6, -0.5, 0.4),
        "point": (0.05, 0.1, -0.04),
        "profile": [{"at": t, "force": f} for t, f in ((0, 0), (0.1, 60), (0.25, -40), (0.5, 30))],
    }
)
MOTIONS = {
    "fall onto the cables": Motion(fall, 0.6, slack=True),
    "release off centre with rotation": Motion(release, 0.5, slack=True),
    "release with damped cables": Motion(release_gently, 0.5, damped=True),
    "an eccentric load that comes and goes": Motion(stay, 0.5, load=PUSH),
    "drums that wind in and out": Motion(stay, 0.5, wind=0.01),
}


def begun(motion: Motion, substep_us: int) -> Plant:
    robot = without_cradle(ROBOT if motion.damped else undamped())
    p = plant(robot, with_plant(frictionless(), substep_us=substep_us), load=motion.load)
    p.position[:] = 0.0
    p.place((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), balanced(p))
    p.locked[:] = True
    motion.begin(p)
    p.start_schedule(p.now_ns)
    return p


def winding(motion: Motion, tick: int) -> Floats:
    """m (8,) wound in at the start of a tick."""
    at = 2.0 * np.pi * 2.0 * 1e-3 * np.array([tick, tick + 1])
    return motion.wind * np.diff(np.sin(at)) * WOUND


def ours(motion: Motion, substep_us: int) -> tuple[Floats, Floats]:
    """Poses (n, 7) and tensions (n, 8) each millisecond."""
    p = begun(motion, substep_us)
    poses, tensions = [], []
    for tick in range(round(motion.seconds * 1000)):
        p.drum_angle += winding(motion, tick) / ROBOT.drum.radius
        p.advance(p.now_ns + TICK_NS)
        poses.append(np.concatenate([p.position, p.quaternion]))
        tensions.append(p.tension.copy())
    return np.array(poses), np.array(tensions)


@contextmanager
def loaded(load: Load | None) -> Iterator[None]:
    """The load port as a force on a point of the body, evaluated at every stage of a step."""

    def control(m: Any, d: Any) -> None:
        assert load is not None
        times, forces = [q.at for q in load.profile], [q.force for q in load.profile]
        direction = np.array(load.direction) / np.linalg.norm(load.direction)
        force = np.interp(d.time, times, forces) * direction
        point = d.xpos[1] + d.xmat[1].reshape(3, 3) @ np.array(load.point)
        d.qfrc_applied[:] = 0.0
        mujoco.mj_applyFT(m, d, force, np.zeros(3), point, 1, d.qfrc_applied)

    mujoco.set_mjcb_control(control if load is not None else None)
    try:
        yield
    finally:
        mujoco.set_mjcb_control(None)


def theirs(motion: Motion) -> tuple[Floats, Floats]:
    p = begun(motion, 250)
    m = model(p, ROBOT.cable.damping if motion.damped else 0.0)
    d = mujoco.MjData(m)
    d.qpos[:] = [*p.position, *p.quaternion]
    # A free joint turns at the rate in its own frame; the plant tells it in the base frame.
    w, v = p.quaternion[0], -p.quaternion[1:]
    rate = p.angular_velocity
    d.qvel[:] = [*p.velocity, *(rate + 2 * np.cross(v, np.cross(v, rate) + w * rate))]
    free = unstretched(p)
    poses, tensions = [], []
    with loaded(motion.load):
        for tick in range(round(motion.seconds * 1000)):
            free -= winding(motion, tick)
            m.tendon_lengthspring[:, 1] = free
            m.tendon_stiffness[:] = ROBOT.cable.axial_stiffness / free
            for _ in range(round(1e-3 / STEP)):
                mujoco.mj_step(m, d)
            mujoco.mj_fwdPosition(m, d)
            mujoco.mj_fwdVelocity(m, d)
            poses.append(d.qpos.copy())
            stretch = np.maximum(0.0, d.ten_length - free)
            damper = m.tendon_damping * d.ten_velocity * (stretch > 0.0)
            tensions.append(ROBOT.cable.axial_stiffness / free * stretch + damper)
    return np.array(poses), np.array(tensions)


@pytest.mark.parametrize("name", MOTIONS)
def test_both_move_alike(name: str) -> None:
    motion = MOTIONS[name]
    theirs_poses, theirs_tensions = theirs(motion)
    assert np.ptp(theirs_poses[:, :3], axis=0).max() > 5e-3
    assert bool(theirs_tensions.min() <= 0.0) is motion.slack
    coarse, fine = ours(motion, LAB.plant.substep_us), ours(motion, LAB.plant.substep_us // 2)
    for what, wanted, limit in ((0, theirs_poses, POSE), (1, theirs_tensions, TENSION)):
        # A second-order error is 4/3 of what halving the step changes.
        error = 4.0 / 3.0 * np.max(np.abs(coarse[what] - fine[what]))
        assert np.max(np.abs(coarse[what] - wanted)) < 1.25 * error < limit
