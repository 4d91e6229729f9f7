"""What the cables truly do to the platform, from the plant's truth alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tonus.config.schema.robot import Geometry

Array = NDArray[np.float64]


def cable_wrench(geometry: Geometry, position: Array, quaternion: Array, tension: Array) -> Array:
    """Forces then moments (n, 6) about the platform's origin, base frame, of true tensions (n, 8)
    at true poses: position (n, 3), quaternion (n, 4) as w x y z.

    Eq. (7) with the full structure matrix; written here on its own, so that a mistake in the
    controller's kinematics cannot hide in its judgement.
    """
    turn = Rotation.from_quat(np.roll(quaternion, -1, axis=1))
    total = np.zeros((len(position), 6))
    anchors = zip(geometry.frame, geometry.platform, strict=True)
    for cable, (frame, tip) in enumerate(anchors):
        arm = turn.apply(np.array(tip))
        way = np.array(frame) - position - arm
        pull = way * (tension[:, cable] / np.linalg.norm(way, axis=1))[:, None]
        total[:, :3] += pull
        total[:, 3:] += np.cross(arm, pull)
    return total
