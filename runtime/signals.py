"""Every signal of a tick, in one table: the single source of truth.

Stages write these fields, the ring copies the record, the MCAP schemas are generated from it, the
log tools decode with it and the documentation prints it. A signal is named here, and written by one
function; a test ties the two.
"""

from __future__ import annotations

from enum import IntEnum
from functools import cache
from types import SimpleNamespace

import numpy as np

from tonus.runtime.topics import Field, Per, Topic, record_dtype

SCHEMA_VERSION = 7
"""Counts up when a field changes its name, type, unit or meaning."""


class Solver(IntEnum):
    """Where a tick's tensions came from."""

    NONE = 0
    OPTIMAL = 1
    """the programme's solution, with bounds that matter"""
    FALLBACK = 2
    """no solution within the iteration limit: closed form, clipped"""
    INTERIOR = 3
    """no bound mattered: the free minimiser itself"""
    REFERENCE = 4
    """as OPTIMAL, by Clarabel: DAQP had no answer, or none that is proven"""


class Grade(IntEnum):
    """The Dynamic Safety Envelope's verdict on a tick (paper, Figure 1)."""

    GREEN = 0
    AMBER = 1
    RED = 2


class Bound(IntEnum):
    """Which bound of the envelope is nearest, or met."""

    NONE = 0
    TENSION_HIGH = 1
    TENSION_LOW = 2
    STIFFNESS = 3
    CONTACT = 4
    SPEED = 5
    WORKSPACE = 6


class Consistency(IntEnum):
    """Whether the measurements of the estimator agree."""

    GOOD = 0
    CABLES = 1
    """the lengths contradict each other, or the motion: slack, a slipped cable, a wrong constant"""
    TRACKER = 2
    """poses in a row lie beyond the gate: the tracker or the reference has moved"""
    SINGULAR = 3
    """the cables hardly determine the pose"""


def _topic(name: str, message: str, doc: str, *fields: Field) -> Topic:
    return Topic(f"/tonus/{name}", f"tonus_msgs/msg/{message}", doc, fields)


def _f8(name: str, size: int, unit: str, doc: str) -> Field:
    return Field(name, "float64", size, unit, doc)


TABLE: tuple[Topic, ...] = (
    _topic(
        "timing",
        "Timing",
        "when the tick ran; values that depend on the host are zero in virtual time",
        Field("tick", "uint64", 0, "", "number of the tick, due at t0 + tick * period"),
        Field("due_ns", "int64", 0, "ns", "due time on the loop's clock"),
        Field("missed_own", "uint32", 0, "", "ticks missed by an overrun of Tonus, so far"),
        Field("missed_host", "uint32", 0, "", "ticks missed by late wake-ups of the host, so far"),
        Field("page_faults", "uint32", 0, "", "within ticks, up to the one before, so far"),
        Field("switches", "uint32", 0, "", "context switches within ticks, likewise"),
        Field("wakeup_us", "float32", 0, "us", "how late the tick started"),
        Field("bus_us", "float32", 0, "us", "from the last exchange to its last answer, 0 unknown"),
        Field("collect_us", "float32", 0, "us", "time in collect"),
        Field("compute_us", "float32", 0, "us", "time in ControlCycle.act"),
        Field("publish_us", "float32", 0, "us", "time in publish"),
        Field("processor_us", "float32", 0, "us", "processor time of these three together"),
        Field("slack_us", "float32", 0, "us", "left of the period after publish"),
        Field("after_us", "float32", 0, "us", "from publish to its end, of the tick before"),
    ),
    _topic(
        "state",
        "State",
        "the state machine",
        _f8("elapsed", 0, "s", "time in the present state"),
        _f8("scenario_time", 0, "s", "time in ACTIVE as the reference sees it"),
        Field("inputs", "uint32", 0, "", "CRC-32 of all inputs of the tick, for a replay"),
        Field("fault", "uint16", 0, "", "Fault that led here, 0 for none"),
        Field("fault_where", "int16", 0, "", "axis, cell or bound of the fault, -1 for none"),
        Field("state", "uint8", 0, "", "State"),
        Field("stop_mode", "uint8", 0, "", "StopMode, 0 but in SAFE_STOP"),
        Field("failed", "uint8", Per.CABLE, "", "1 for an excluded cable"),
        Field("operator", "uint8", 0, "", "operator command of this tick, 0 for none"),
        Field("select", "uint8", 0, "", "scenario chosen in this tick, its number plus 1; or 0"),
        Field("scenario", "uint8", 0, "", "number of the scenario in force"),
        Field(
            "unguarded", "uint8", 0, "", "1: the STO relay is silent; 2: the supervisor is ignored"
        ),
    ),
    _topic(
        "drives",
        "Drives",
        "inputs from the axes and the commands to them",
        _f8("angle", Per.CABLE, "rad", "drum angle since switch-on, reeling in positive"),
        _f8("torque", Per.CABLE, "N m", "the drive's own torque figure, at the drum"),
        _f8("torque_command", Per.CABLE, "N m", "commanded torque at the drum"),
        _f8("rate", Per.CABLE, "rad/s", "drum rate"),
        Field(
            "sampled_ns", "int64", Per.CABLE, "ns", "when SYNC or SYNC0 took the sample; 0: unknown"
        ),
        Field("doubt_ns", "int64", Per.CABLE, "ns", "by how much that may be wrong"),
        Field("age", "uint16", Per.CABLE, "ticks", "age of the measurement"),
        Field("statusword", "uint16", Per.CABLE, "", "CiA 402 statusword"),
        Field("error_code", "uint16", Per.CABLE, "", "error code of the last emergency"),
        Field("state", "uint8", Per.CABLE, "", "AxisState"),
        Field("command", "uint8", Per.CABLE, "", "AxisCommand"),
    ),
    _topic(
        "force_cells",
        "ForceCells",
        "the cables' cells and, last, the contact port's",
        _f8("raw", Per.CELL, "N", "as reported"),
        _f8("tare", Per.CELL, "N", "subtracted"),
        _f8("filtered", Per.CELL, "N", "tared and low-passed"),
        Field("age", "uint16", Per.CELL, "ticks", "age of the measurement"),
        Field("status", "uint8", Per.CELL, "", "CiA 404 status, 0 good"),
    ),
    _topic(
        "tracker",
        "Tracker",
        "the optical tracker's last pose",
        _f8("position", 3, "m", "platform origin in the base frame"),
        _f8("quaternion", 4, "", "w x y z"),
        _f8("delay", 0, "s", "from the pose's timestamp to this tick"),
        _f8("disagreement", 0, "m", "mean distance of the poses refused in a row, 0 for none"),
        Field("sequence", "uint32", 0, "", "datagram number"),
        Field("refused", "uint32", 0, "", "poses refused in a row"),
        Field("learnt", "uint32", 0, "", "lasting disagreements that the estimator has followed"),
        Field("fresh", "uint8", 0, "", "1 when the pose arrived in this tick"),
        Field("accepted", "uint8", 0, "", "1 when the estimator used it"),
    ),
    _topic(
        "pose",
        "Pose",
        "estimated and desired motion of the platform",
        _f8("position", 3, "m", "estimate"),
        _f8("quaternion", 4, "", "estimate, w x y z"),
        _f8("velocity", 3, "m/s", "estimate"),
        _f8("angular_velocity", 3, "rad/s", "estimate, base frame"),
        _f8("desired_position", 3, "m", "reference"),
        _f8("desired_velocity", 3, "m/s", "reference"),
        _f8("desired_acceleration", 3, "m/s2", "reference"),
        _f8("desired_quaternion", 4, "", "reference, w x y z"),
        _f8("cable_position", 3, "m", "pose solved from the cables alone"),
        _f8("bias", 3, "m", "estimated error of the cables' pose"),
        _f8("residual", 0, "m", "disagreement of the cable lengths, RMS"),
        _f8("length_offset", Per.CABLE, "m", "estimated, to be added to the measured lengths"),
        _f8("compliance", 0, "", "of the cables, estimated, over the nominal one"),
        _f8("sigma", 0, "m", "standard deviation of the position along its worst axis"),
        _f8("inconsistency", 0, "", "mean squared innovation of the lengths in sigmas, about 1"),
        _f8("condition", 0, "", "condition number of the structure matrix, moments scaled"),
        Field("consistency", "uint8", 0, "", "Consistency"),
    ),
    _topic(
        "stiffness",
        "Stiffness",
        "the law, the envelope's cap and the limiter, in this order",
        _f8("law", 0, "N/m", "eq. (3) or (10), clipped to its bounds"),
        _f8("velocity_term", 0, "", "relative increase due to velocity"),
        _f8("force_term", 0, "", "relative increase due to force"),
        _f8("deviation_term", 0, "", "relative increase due to deviation"),
        _f8("cap", 0, "N/m", "the envelope's upper bound in this tick"),
        _f8("k_eq", 0, "N/m", "commanded equivalent stiffness"),
        _f8("measured", 0, "N/m", "k_eq plus the measured tensions' geometric stiffness along d"),
    ),
    _topic(
        "wrench",
        "Wrench",
        "forces then moments on the platform, base frame",
        _f8("commanded", 6, "N, N m", "for the cables to deliver"),
        _f8("delivered", 6, "N, N m", "structure matrix times the tension reference"),
        _f8("external", 6, "N, N m", "estimated external load"),
        _f8("deficit", 0, "N", "norm of what was not delivered, moments scaled"),
        _f8("contact", 0, "N", "contact port"),
    ),
    _topic(
        "tension",
        "Tension",
        "reference and measurement of every cable",
        _f8("reference", Per.CABLE, "N", "distributed"),
        _f8("co_contraction", Per.CABLE, "N", "target of the distribution"),
        _f8("measured", Per.CABLE, "N", "tared load cell, unfiltered"),
        _f8("integral", Per.CABLE, "N", "integral part of the tension loop"),
        _f8("agonism", Per.CABLE, "", "1 pulls with the commanded wrench, -1 against it"),
        Field("iterations", "uint8", 0, "", "of the solver"),
        Field("solver", "uint8", 0, "", "Solver"),
    ),
    _topic(
        "envelope",
        "Envelope",
        "Dynamic Safety Envelope: margins as shares of their span, predicted over the horizon",
        _f8("tension_high", 0, "", "smallest margin to T_max"),
        _f8("tension_low", 0, "", "smallest margin to T_min"),
        _f8("contact", 0, "", "margin to the contact limit"),
        _f8("speed", 0, "", "margin to the speed limit"),
        _f8("workspace", 0, "m", "distance to the nearest face of the box"),
        _f8("progress", 0, "", "rate at which the reference is allowed to go on, 0 to 1"),
        Field("grade", "uint8", 0, "", "Grade"),
        Field("bound", "uint8", 0, "", "Bound that decided the grade"),
    ),
    _topic(
        "energy",
        "Energy",
        "eq. (12) and (13) of the translational loop, from estimates, and the tank",
        _f8("storage", 0, "J", "V = 1/2 m e'^2 + 1/2 K_eq e^2, eq. (12)"),
        _f8("storage_rate", 0, "W", "its derivative: stiffening - dissipated + external"),
        _f8("stiffening", 0, "W", "1/2 K_eq' e^2, the term eq. (13) leaves out"),
        _f8("dissipated", 0, "W", "D e'^2, taken by the virtual damper"),
        _f8("external", 0, "W", "-F e', put in by the estimated external force"),
        _f8("tank", 0, "J", "what a rise of the stiffness may still draw on"),
        _f8("k_rate", 0, "N/m/s", "K_eq'"),
        _f8("rise_bound", 0, "N/m/s", "how fast K_eq may rise now"),
    ),
    # The last one: a keyframe of before there was any holds what stands before it.
    _topic(
        "tuning",
        "Tuning",
        "parameters of the law changed while the robot runs (operation.tunable)",
        _f8("value", 0, "", "commanded in this tick for `parameter`, else 0"),
        _f8("gains", 3, "", "in force: deviation, velocity and force gain; 0 without a law"),
        Field("parameter", "uint8", 0, "", "number in operation.tunable, plus 1; 0 for none"),
    ),
)

"""Of any robot. The number of its cables gives fields their sizes: `topics`."""


@cache
def topics(cables: int) -> tuple[Topic, ...]:
    """The topics of a robot with so many cables."""
    return tuple(topic.sized(cables) for topic in TABLE)


@cache
def cycle_dtype(cables: int) -> np.dtype[np.void]:
    """One tick's record of all topics, of a robot with so many cables."""
    return record_dtype(topics(cables))


class CycleRecord(SimpleNamespace):
    """One preallocated record and, under ``topic.field``, a view into each of its fields.

    A scalar's view has shape (), so it is written with ``view[...] = value``; an array's is written
    with ``view[:] = values``.
    """

    def __init__(self, cables: int) -> None:
        self.cables = cables
        self.data = np.zeros(1, cycle_dtype(cables))
        for topic in topics(cables):
            short = topic.name.rsplit("/", 1)[1]
            part = self.data[short]
            views = {
                f.name: part[f.name][0] if f.size else part[f.name].reshape(())
                for f in topic.fields
            }
            setattr(self, short, SimpleNamespace(**views))
