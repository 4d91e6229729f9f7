"""What panels of a report share."""

from __future__ import annotations

import io
import warnings
from types import SimpleNamespace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tonus.runtime.states import State
from tonus.tools.report import panels


def test_a_fault_beyond_the_panels_times_takes_no_room() -> None:
    """Its name stood outside, and the layout left nothing for the panels."""
    story: Any = SimpleNamespace(
        bands=[(State.ACTIVE, 0.0, 100.0)],
        time=np.linspace(0.0, 100.0, 11),
        faults=[
            {"name": name, "where": "can1/3 (axis 2)", "tick": tick}
            for name, tick in (("drive_lost", 1), ("length_drift", 90))
        ],
        at=float,
    )
    figure = Figure(figsize=(11.0, 5.0), layout="constrained")
    axes = list(figure.subplots(2, 1, sharex=True))
    for axis in axes:
        axis.plot(story.time, story.time, label="load, estimated")
    panels.dress(axes, story, names=False)
    axes[0].set_xlim(0.5, 1.5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure.savefig(io.BytesIO(), format="png")
    assert axes[0].get_position().width > 0.6
