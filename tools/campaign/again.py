"""The recorded inputs of a run once more, held in memory: `tonus.tools.log.replay` without a
log."""

from __future__ import annotations

import numpy as np

from tonus.drivers.process_image import ProcessImage
from tonus.runtime.control.tuning import GainChange
from tonus.runtime.cycle import ControlCycle
from tonus.runtime.signals import TABLE, cycle_dtype
from tonus.runtime.states import Operator
from tonus.tools.campaign.observed import Observed

_INPUTS = {
    "drives": (
        "axes",
        (
            *("angle", "torque", "sampled_ns", "doubt_ns"),
            *("statusword", "error_code", "age", "state"),
        ),
    ),
    "force_cells": ("cells", ("age", "status")),
    "tracker": ("tracker", ("position", "quaternion", "delay", "sequence", "fresh")),
}
"""Where the image's tables are recorded, under the names they have there."""


def first_difference(run: Observed) -> tuple[int, str] | None:
    """Row and signal of the first output that differs by a bit, None if none does. The records
    begin with the run's first tick."""
    config, cycle = run.config, run.cycle
    fresh = ControlCycle(
        config.robot,
        config.control,
        config.tracker,
        run.scenario.reference,
        tunable=config.operation.tunable,
    )
    image = ProcessImage(config.robot.cables)
    tables = [
        (getattr(image, table)[name], cycle[topic][name])
        for topic, (table, names) in _INPUTS.items()
        for name in names
    ]
    tables.append((image.cells["force"], cycle["force_cells"]["raw"]))
    ticks = cycle["timing"]["tick"].tolist()
    operators = cycle["state"]["operator"].tolist()
    selects = cycle["state"]["select"].tolist()
    unguarded = cycle["state"]["unguarded"].tolist()
    tuned = cycle["tuning"]
    changes = list(map(GainChange, tuned["parameter"].tolist(), tuned["value"].tolist()))
    out = np.zeros(len(ticks), cycle_dtype(config.robot.cables))
    for index, tick in enumerate(ticks):
        for table, rows in tables:
            table[...] = rows[index]
        image.unguarded = bool(unguarded[index] & 1)
        image.supervisor_ignored = bool(unguarded[index] & 2)
        operator = Operator(operators[index])
        select, change = selects[index], changes[index]
        out[index] = fresh.step(image, tick, operator, select, change).data[0]
    found: list[tuple[int, str]] = []
    for topic in TABLE:
        short = topic.name.rsplit("/", 1)[1]
        for name in (each.name for each in topic.fields if short != "timing"):
            then, now = np.ascontiguousarray(cycle[short][name]), out[short][name]
            bits = (len(ticks), -1)
            same = then.view(np.uint8).reshape(bits) == np.ascontiguousarray(now).view(
                np.uint8
            ).reshape(bits)
            if not same.all():
                found.append((int((~same.all(axis=1)).argmax()), f"{topic.name}.{name}"))
    return min(found, default=None)
