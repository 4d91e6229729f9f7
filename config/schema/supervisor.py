"""The supervisor: a second process that judges the daemon from the bus and from its record."""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from tonus.config.schema.base import Count, NodeId, NonNegative, Number, Positive, Section, Share
from tonus.config.schema.realtime import Priority, Processors


def _off(value: object) -> object:
    """YAML reads a bare off as false, and nothing else can be meant by it here."""
    return "off" if value is False else value


class Requirement(IntEnum):
    """What the supervisor demands while a drive is enabled; docs/supervisor.md. Its emergency
    frame carries the number."""

    TICK = 1
    TORQUE = 2
    FROZEN = 3
    UNEXPLAINED = 4
    OPPOSED = 5
    TENSION = 6
    CONTACT = 7
    SPEED = 8
    STIFFNESS = 9
    COMMAND_LOGGED = 10
    MEASURED_LOGGED = 11
    DISARMED = 12
    STOP_ENDS = 13
    STALE = 14
    LATE = 24
    ORDERS = 25
    BRAKED = 26
    COMMANDED = 27


REQUIREMENT_TEXTS: dict[Requirement, str] = {
    Requirement.TICK: "the daemon records a tick in time",
    Requirement.TORQUE: "an enabled drive is sent a torque in time",
    Requirement.FROZEN: "the torques change when tensions or the drums' rates do",
    Requirement.UNEXPLAINED: "a drive's torque is explained by its tension and its drum's motion",
    Requirement.OPPOSED: "a torque does not drive its cable's tension away from the reference",
    Requirement.TENSION: "no tension is beyond its bound",
    Requirement.CONTACT: "no contact force is beyond its bound",
    Requirement.SPEED: "the drums' speeds allow the platform to be within its speed bound",
    Requirement.STIFFNESS: "K_eq is within its bounds and rises no faster than allowed",
    Requirement.COMMAND_LOGGED: "the torque on the bus is the one that the daemon records",
    Requirement.MEASURED_LOGGED: "the recorded forces and lengths are those on the bus",
    Requirement.DISARMED: "the drives have power as the daemon's record says",
    Requirement.STOP_ENDS: "a controlled stop comes to its end, and never back to a mode of before",
    Requirement.STALE: "no torque is sent to a drive whose measurements have stopped",
    Requirement.LATE: "it looks in time itself",
    Requirement.ORDERS: "a stop follows an order to stop, and a fault, that are recorded",
    Requirement.BRAKED: "a passive stop drives no drum, and brakes each that pays out",
    Requirement.COMMANDED: (
        "no device is commanded beside its process data, nor in its name, nor armed after it has "
        "restarted without being brought up"
    ),
}


LARGEST = {
    "axis_torque_ms": 200.0,
    "stale_ms": 40.0,
    "disarmed_ms": 100.0,
    "stopping_ms": 120.0,
    "stop_s": 80.0,
    "quiet_s": 0.5,
    "window_ms": 50.0,
    "opposed_ms": 50.0,
    "frozen_frames": 20.0,
    "frozen_rate": 0.06,
    "frozen_tension": 0.1,
    "logged_length": 0.002,
    "logged_ticks": 16.0,
    "margin": 1.2,
    "rotation": 3.0,
    "rotation_in_descent": 5.5,
    "rotation_stopping": 20.0,
}
"""What a robot may state, in the keys' units, frames and ticks as of 1 ms; in a lab the keys' own
bounds hold. All R: with more a mistake is found too late. `tonus.config.schema.place` has period,
patience and timeout."""
LARGEST_TENSION = 10.0
"""times what a cable may carry: ``tension_stopping``, in a lab too. R"""
LARGEST_SHARES = {
    "unexplained_force": 2.0,
    "opposed_force": 1.5,
    "opposed_error": 0.1,
    "logged_tension": 0.5,
    "opposed_long_force": 0.5,
    "opposed_long_error": 0.25,
    "excess_force": 8.0,
    "answered_torque": 0.5,
    "passive_torque": 0.25,
}
"""The same of the keys in N, as shares of the pretension, which is what a cable without torque
lacks. All R."""
SMALLEST = {
    "stopping_ms": 100.0,
    "window_ms": 8.0,
    "opposed_ms": 10.0,
    "logged_length": 0.0002,
    "opposed_error": 1.0,
    "frozen_frames": 3.0,
    "frozen_rate": 0.01,
    "frozen_tension": 0.02,
    "logged_ticks": 2.0,
    "margin": 1.05,
    "rotation": 0.3,
    "rotation_stopping": 3.0,
    "speed_stopping": 1.5,
    "speed_on_path": 0.4,
    "speed_in_descent": 0.7,
    "rotation_in_descent": 4.5,
}
"""What a robot has to state at least, in the keys' units, frames and ticks. All R: between what a
robot in order was seen to reach (config/supervisor.yaml) and what is shipped."""
SMALLEST_SHARES = {
    "unexplained_force": 1.5,
    "opposed_force": 1.0,
    "logged_tension": 0.15,
    "opposed_long_force": 0.3,
    "opposed_long_error": 0.1,
    "excess_force": 6.0,
    "answered_torque": 0.05,
    "passive_torque": 0.025,
}
"""The same of the keys in N, as shares of the pretension. All R."""
LARGEST_SPREAD = 0.4
"""of the frame's smallest half-width. R: with 0.2 the speed found is 0.81 of the true one in the
worst direction, with 0.4 it is 0.65, with 0.7 it is 0.4"""


class Supervisor(Section):
    """Judges while a drive is enabled, and stops the robot by ending its heartbeat. Its times and
    its margin have an upper bound: with more it would not stop what it is there for."""

    policy: Annotated[Literal["require", "use", "off"], BeforeValidator(_off)]
    """require: the robot is not armed unless the supervisor's heartbeat is received on every CAN
    channel; use: it is started, and the robot is armed without it too; off: there is none. Left out
    it is what `tonus.config.schema.place` says, like ``period_ms``, ``timeout_ms``, ``patience_ms``
    """
    node_id: NodeId
    """of its heartbeat and its emergency frame, on every channel"""
    period_ms: Annotated[Count, Field(le=20)]
    """how often it judges, and sends its heartbeat"""
    timeout_ms: Annotated[Count, Field(le=200)]
    """0x1016:2, how long drives wait for its heartbeat"""
    patience_ms: Annotated[Positive, Field(le=100)]
    """how long a condition may last, where no other time is stated"""
    axis_torque_ms: Annotated[Positive, Field(le=300)]
    """how long one drive of several may be without a torque"""
    stale_ms: Annotated[Positive, Field(le=100)]
    """how long a drive that is sent a torque may be without a measurement"""
    disarmed_ms: Annotated[Positive, Field(le=200)]
    """how long a drive may stay enabled after the daemon said that it is disarmed"""
    stopping_ms: Annotated[Positive, Field(le=500)]
    """how long a bound for all states may be exceeded"""
    stop_s: Annotated[Positive, Field(le=120)]
    """longest controlled stop"""
    quiet_s: Annotated[Positive, Field(le=2)]
    """how long no drive may be enabled before the heartbeat begins, or begins again"""
    frozen_frames: Annotated[Count, Field(le=100)]
    """RPDOs of all drives in a row to the last bit equal"""
    frozen_rate: Annotated[Positive, Field(le=0.2)]
    """m/s by which a cable's rate may change before some torque does"""
    frozen_tension: Annotated[Positive, Field(le=2)]
    """N by which a tension may, while the robot is controlled"""
    window_ms: Annotated[Positive, Field(le=100)]
    """over which a drive's torque is compared with its cable and its drum"""
    unexplained_force: Annotated[Positive, Field(le=200)]
    """N at the cable: friction, and what the window blurs"""
    unexplained_share: Annotated[Share, Field(le=0.5)]
    """and of the torque itself: the gearbox's efficiency"""
    opposed_force: Annotated[Positive, Field(le=200)]
    """N between torque and tension, in the direction away from the reference"""
    opposed_error: Annotated[Positive, Field(le=20)]
    """N between tension and reference"""
    opposed_long_force: Annotated[Positive, Field(le=100)] = 20.0
    """N as ``opposed_force``, which may last for ``opposed_ms``: in HOLD, ACTIVE, a stop along the
    path"""
    opposed_long_error: Annotated[Positive, Field(le=50)] = 8.0
    """N as ``opposed_error``, the same way"""
    opposed_ms: Annotated[Positive, Field(le=100)] = 20.0
    excess_force: Annotated[Positive, Field(le=500)] = 300.0
    """N between torque and reference, on the reference's side: while the robot is controlled for
    ``patience_ms``, in a stop along the path for ``opposed_ms``"""
    margin: Annotated[Number, Field(ge=1, le=1.5)]
    """times the envelope's bounds of tension, contact and speed while the robot is controlled"""
    tension_stopping: Positive
    """N, in SAFE_STOP for ``opposed_ms``"""
    contact_stopping: Annotated[Positive, Field(le=100)]
    """N, in every state"""
    contact_at_once: Annotated[Positive, Field(le=200)] = 70.0
    """N that a stop may not exceed for longer than ``patience_ms``"""
    speed_on_path: Annotated[Positive, Field(le=2)] = 0.5
    """m/s, in a stop along the path for ``opposed_ms``; with ``rotation``"""
    speed_in_descent: Annotated[Positive, Field(le=3)] = 0.8
    """m/s, in a stop that is neither along the path nor passive, for ``patience_ms``"""
    speed_stopping: Annotated[Positive, Field(le=5)]
    """m/s, in every state"""
    rotation: Annotated[Positive, Field(le=5)]
    """rad/s, while the robot is controlled"""
    rotation_in_descent: Annotated[Positive, Field(le=10)] = 5.0
    """rad/s, in such a stop for twice ``opposed_ms``"""
    rotation_stopping: Annotated[Positive, Field(le=30)]
    """rad/s, in every state"""
    logged_tension: Annotated[Positive, Field(le=50)]
    """N by which a recorded force may differ from the one on the bus"""
    logged_length: Annotated[Positive, Field(le=0.01)] = 0.0005
    """m by which a recorded length of cable may be outside of those on the bus lately"""
    answered_torque: Annotated[Positive, Field(le=100)] = 10.0
    """N at the cable by which the torque that a drive reports may be outside of those that it was
    sent lately; judged where its frames are not read"""
    passive_torque: Annotated[Positive, Field(le=100)] = 5.0
    """N at the cable, in a passive stop, by which a torque may exceed the passive tension while its
    drum reels in, pull the other way while it pays out, or be less than ``damped_share`` asks"""
    damped_share: Annotated[Number, Field(ge=0.4, le=0.75)] = 0.5
    """of ``control.stop.passive_damping``, with which a drum that pays out is braked at least"""
    logged_ticks: Annotated[int, Field(ge=1, le=64)]
    """records before the last two looks among which a torque on the bus may be too"""
    priority: Priority
    """SCHED_FIFO; it need not be above the daemon's: a supervisor that is kept from its turn is
    silent, and the robot stops"""
    cpu: Processors | None = None
    processors: Count = 3
    """beside a lab in real time, ``use`` starts it on a host with at least so many: daemon, lab and
    supervisor need one each, or the drives in the lab answer too late"""
    spread: Annotated[NonNegative, Field(le=0.2)] = 0.15
    """m from the middle of the workspace to the poses at which the structure matrix is taken"""

    @property
    def longest_look_ms(self) -> float:
        """SUP-24: looks that are further apart are late."""
        return 2 * self.period_ms + self.patience_ms

    @model_validator(mode="after")
    def _stays_silent(self) -> Supervisor:
        if self.quiet_s * 1e3 < 2 * self.timeout_ms:
            raise ValueError(
                f"quiet_s is {self.quiet_s:g}: the heartbeat would begin again before drives that "
                f"wait {self.timeout_ms} ms for it have stopped; set it to at least "
                f"{2e-3 * self.timeout_ms:g}"
            )
        return self

    @model_validator(mode="after")
    def _survives_a_lost_heartbeat(self) -> Supervisor:
        if self.timeout_ms < 2 * self.period_ms + 1:
            raise ValueError(
                f"timeout_ms is {self.timeout_ms}: one lost heartbeat of {self.period_ms} ms would "
                f"stop the robot; set it to at least {2 * self.period_ms + 1}"
            )
        return self


__all__ = [
    "LARGEST",
    "LARGEST_SHARES",
    "LARGEST_SPREAD",
    "LARGEST_TENSION",
    "REQUIREMENT_TEXTS",
    "SMALLEST",
    "SMALLEST_SHARES",
    "Requirement",
    "Supervisor",
]
