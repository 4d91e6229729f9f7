"""What the robot is like at the moment of the break: the real controller in HOLD, from truth."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tests.bench.least_stop.push import NO_PUSH, Push
from tests.loop import QUICK, ClosedLoop, configured
from tonus.runtime.states import State

Array = NDArray[np.float64]
POSITIONS = tuple(product((-0.15, 0.0, 0.15), (-0.15, 0.0, 0.15), (-0.06, 0.0, 0.12)))
"""m: 60 % of the workspace box; the lower layer lies 40 mm above the table instead of in it"""
_LIFT_S = 3.5
"""so long that the lift to the farthest pose keeps the speed limit"""
_SETTLE_S = 0.5
_PUSHED_S = 1.0
_MEAN_TICKS = 100


@dataclass(frozen=True)
class Hold:
    """An equilibrium of the controlled robot; means over the last 100 ms of truth."""

    position: Array
    """m (3,)"""
    quaternion: Array
    """(4,), platform to base, scalar first"""
    tension: Array
    """N (8,)"""


def hold_at(position: tuple[float, float, float], push: Push = NO_PUSH) -> Hold:
    """Bring the shipped robot up with its home at ``position`` (m) and let it settle in HOLD, under
    a push that grows slowly and stays."""
    overrides = {**QUICK, "robot.home": list(position), "control.sequence.lift_s": _LIFT_S}
    loop = ClosedLoop(*configured("hold", overrides))
    loop.until(State.HOLD, within=20.0)
    if push != NO_PUSH:
        loop.plant.defects.push(push.force, push.point, rise=_SETTLE_S)
        loop.run(_PUSHED_S)
    loop.run(_SETTLE_S)
    last = loop.trace.truth[-_MEAN_TICKS:]
    quaternion = np.asarray(last["quaternion"]).mean(axis=0)
    return Hold(
        np.asarray(last["position"]).mean(axis=0),
        quaternion / np.linalg.norm(quaternion),
        np.asarray(last["tension"]).mean(axis=0),
    )
