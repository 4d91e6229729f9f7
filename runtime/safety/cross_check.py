"""Drums, lengths and cells of a tick compared with each other, once its torques are sent.

The drives need not wait for it: the first to ask what drum observer, witness and isolation have
found is the state machine of the next tick.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tonus.drivers.process_image import ProcessImage
from tonus.runtime.control.estimator import PoseEstimator
from tonus.runtime.control.referencing import Referencing
from tonus.runtime.control.sensing import Sensing
from tonus.runtime.safety.isolation import Isolation
from tonus.runtime.safety.sequence import Sequence
from tonus.runtime.safety.witness import Witness

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class CrossCheck:
    """`begin` while the tick is computed, `finish` when its torques are sent."""

    def __init__(
        self,
        sensing: Sensing,
        sequence: Sequence,
        referencing: Referencing,
        estimator: PoseEstimator,
        isolation: Isolation,
        witness: Witness,
    ) -> None:
        self._sensing, self._sequence, self._referencing = sensing, sequence, referencing
        self._estimator, self._isolation, self._witness = estimator, isolation, witness
        self._before: tuple[Array, Array, Array, Mask, bool] | None = None
        """from `begin` to `finish`"""

    def begin(
        self,
        torque: Array,
        following: Array,
        reference: Array,
        taking_up: Mask,
        *,
        skipped: bool,
    ) -> None:
        """Of the tick before, which this one writes over: torques (n,) N m, the rates (n,) rad/s at
        which drums would follow the platform, and tension references (n,) N, of which each tick has
        an array of its own; ``taking_up`` (n,): drums of given-up cables that took up slack;
        ``skipped``: ticks between the two were missed."""
        self._before = (torque.copy(), following.copy(), reference, taking_up.copy(), skipped)

    def rehearse(self, image: ProcessImage) -> None:
        """What no tick asks before a cable is given up."""
        failed = self._sequence.faults.failed
        self._isolation.given_up.step(image, self._sensing, failed, np.zeros(len(failed)))

    def finish(self, image: ProcessImage) -> None:
        """Nothing where control has not come as far as `begin`."""
        if self._before is None:
            return
        torque, following, reference, taking_up, skipped = self._before
        self._before = None
        sensing, sequence, estimator = self._sensing, self._sequence, self._estimator
        failed = sequence.faults.failed
        self._isolation.drums.step(
            image,
            sensing,
            # Driven by what its cell and encoder say, one that is given up may run away by them.
            failed & ~taking_up,
            torque,
            following,
            skipped=skipped,
            enabled=sequence.enabled,
        )
        if failed.any():
            faults = sequence.faults
            watched = failed & ~taking_up & faults.drums_readable & faults.drums_obedient
            if skipped or not sequence.enabled:
                watched[:] = False
            self._isolation.given_up.step(image, sensing, watched, torque)
            cells, held = image.cells[: len(failed)], faults.held
            self._isolation.unwound(
                cells["force"], cells["age"], sensing.tension, sensing.angle, held
            )
            faults.freed |= self._isolation.freed(sensing.angle)
        regulating = sequence.regulating
        if not regulating and (sequence.passive_share < 0.0 or not sequence.referenced):
            return
        self._witness.step(image, self._referencing.measured, sensing.tension, failed)
        if regulating:
            self._isolation.step(
                estimator.innovations,
                estimator.doubts,
                reference,
                sensing.filtered,
                sequence.sound,
                image.cell.force,
                image.cell.age,
                sensing.tension,
            )
