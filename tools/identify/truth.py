"""What a lab's robot really is, to be put beside what was identified."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import yaml
from numpy.typing import NDArray

from tonus.config.schema.scenario import Scenario
from tonus.sim.plant import Plant
from tonus.tools.errors import ToolError
from tonus.tools.identify.record import Record
from tonus.tools.identify.response import estimates, response_between
from tonus.tools.run.summary import TRUTH, truth_at_cycles

Array = NDArray[np.float64]
Known = float | tuple[float, ...]
"""one value, or one of each axis"""


def truth_of(known: dict[str, Known], name: str, axes: Sequence[int]) -> float | None:
    """The true value of an estimate: of several ``axes`` the mean."""
    value = known.get(name)
    if isinstance(value, tuple):
        return float(np.mean([value[axis] for axis in axes]))
    return value


def true_values(
    records: Sequence[Record], moving: Sequence[Record], yielding: Sequence[Record]
) -> dict[str, Known]:
    """By the estimates' names. The plant's parameters are those that the log's seed draws, of
    cables and drums one each; what holds the platform from outside is the phantom along its
    normal; the closed loop is the response between true load and true position.

    Raises ToolError for a log that is not a lab's, or of robots that differ.
    """
    drawn = [_drawn(record) for record in records]
    if any(values != drawn[0] for values in drawn[1:]):
        raise ToolError(
            f"{records[0].path}: the logs' true robots differ, by lab or seed; --truth needs one"
        )
    values: dict[str, Known] = dict(drawn[0])
    outside = [_outside(record) for record in moving]
    if outside and all(held == outside[0] for held in outside):
        values |= outside[0]
    parts = [
        (record, _true(record, "load"), _true(record, "position") - record.desired)
        for record in yielding
    ]
    response = response_between("loop", parts) if parts else None
    if response is not None:
        values |= {e.name: e.value for e in estimates(response, (None, None, None))}
    return values


def _outside(record: Record) -> dict[str, float]:
    """Empty for a phantom that is not a spring and a damper."""
    text = record.log.attachments.get("scenario.yaml", b"")
    scenario = Scenario.model_validate(yaml.safe_load(text)) if text else None
    lab = record.config.lab
    phantom = (scenario.lab.phantom if scenario else None) or (lab.phantom if lab else None)
    if phantom is None:
        return {"outer_damping": 0.0, "outer_stiffness": 0.0}
    if phantom.model == "kelvin_voigt":
        return {"outer_damping": phantom.damping, "outer_stiffness": phantom.stiffness}
    return {}


def _true(record: Record, field: str) -> Array:
    """The first three of a field (n, 3), sampled when the drives are: a tick before the cycle."""
    values = truth_at_cycles(record.log, field)
    assert values is not None
    later = record.on_grid(values[:, :3])
    return np.vstack([later[:1], later[:-1]])


def _drawn(record: Record) -> dict[str, Known]:
    """The plant's own parameters."""
    robot, lab, seed = record.config.robot, record.config.lab, record.log.metadata.get("seed", "")
    if lab is None or TRUTH not in record.log or not seed.isdigit():
        raise ToolError(f"{record.path}: not a lab's log, so it has no truth; leave out --truth")
    plant = Plant(robot, lab, seed=int(seed), phantom=None, load=None).parameters[0]
    efficiency = tuple((1.0 - plant["driving_loss"]).tolist())
    # A stiffening cable's EA is that of small changes about the pretension.
    stiffness = plant["axial_stiffness"] + plant["stiffening"] * record.config.control.tension.pre
    return {
        "platform_mass": float(plant["mass"]),
        "moved_mass": float(plant["mass"]),
        "axial_stiffness": tuple(stiffness.tolist()),
        # The cells' low-pass, which is not damping, is the lab's own in the log's configuration.
        "cable_damping": tuple(plant["cable_damping"].tolist()),
        "drum_inertia": tuple(plant["drum_inertia"].tolist()),
        "viscous_friction": tuple(plant["viscous"].tolist()),
        "coulomb_friction": tuple((plant["coulomb"] / plant["radius"]).tolist()),
        "load_friction": tuple(plant["load_friction"].tolist()),
        "efficiency_driving": efficiency,
        "efficiency_driven": efficiency,
    }
