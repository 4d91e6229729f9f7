"""The paper's controller, impedance at the stiffness of the bio-inspired law, and two variants that
add what the law lacks: something that takes up a constant load."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tonus.config.schema.control import Control
from tonus.config.schema.robot import Robot
from tonus.runtime.control.controllers.base import Array, Controller, Motion, norm, share
from tonus.runtime.control.controllers.integral import Integral
from tonus.runtime.control.controllers.linear import LinearLaw
from tonus.runtime.control.stiffness import Law


class Bio(Controller):
    """Spring and damper at K_eq of eq. (3) or (10). What the law reads is smoothed first."""

    def __init__(self, robot: Robot, control: Control, damping_ratio: float | None = None) -> None:
        super().__init__(robot, control, damping_ratio or control.bio.damping_ratio)
        self._law = Law(control.stiffness)
        self.terms = self._law.terms
        self._share = share(control.stiffness.smoothing_hz, control.rates.period)
        self._error = self._speed = self._force = 0.0

    @property
    def tunable_law(self) -> Law:
        return self._law

    def reset(self) -> None:
        self._error = self._speed = self._force = 0.0

    def linear_laws(self) -> tuple[LinearLaw, ...]:
        law = self._control.stiffness
        return (self._spring(law.base), self._spring(law.maximum))

    def stiffness(self, motion: Motion) -> float:
        source = self._control.stiffness.velocity_source
        rate = motion.error_rate if source == "error" else motion.velocity
        self._error += self._share * (norm(motion.error) - self._error)
        self._speed += self._share * (norm(rate) - self._speed)
        self._force += self._share * (norm(motion.external) - self._force)
        return self._law(self._error, self._speed, self._force)


class BioIntegral(Bio):
    """`bio` with the same integral as `pid`, at a gain of its own."""

    def __init__(self, robot: Robot, control: Control) -> None:
        super().__init__(robot, control, control.bio_integral.damping_ratio)
        self._integral = Integral(control.bio_integral, control.rates.period)

    def reset(self) -> None:
        super().reset()
        self._integral.reset()

    def linear_laws(self) -> tuple[LinearLaw, ...]:
        gain = self._control.bio_integral.gain
        return tuple(replace(spring, integral=gain) for spring in super().linear_laws())

    def force(self, motion: Motion, stiffness: float) -> Array:
        base = self._control.stiffness.base
        integral = self._integral(motion, stiffness, held=stiffness < base)
        return np.asarray(super().force(motion, stiffness) + min(stiffness / base, 1.0) * integral)


class BioObserver(Bio):
    """`bio` with what a limb has besides: it feels loads, feels contact, and rests.

    *Observer*: the estimated external force, low-passed and bounded, is fed forward. The contact
    cell tells a load from a contact: only what the contact force does not account for is
    compensated, so that the robot stays as soft as `bio` where it touches. *Reflex*: where a
    scenario asks for a force, the contact's lack of it is integrated. *Tone*: at rest the tensions
    are drawn to a share of the pretension; stiffness brings co-contraction with it.
    """

    def __init__(self, robot: Robot, control: Control) -> None:
        settings = self._settings = control.bio_observer
        super().__init__(robot, control, settings.damping_ratio)
        self.tone = settings.tone
        self._follow = share(settings.cutoff_hz, control.rates.period)
        self._step = settings.reflex * control.rates.period
        self._load = np.zeros(3)
        self._reflex = 0.0

    def reset(self) -> None:
        super().reset()
        self._load[:] = 0.0
        self._reflex = 0.0

    def linear_laws(self) -> tuple[LinearLaw, ...]:
        """Free, and touching a body."""
        body, hz = self._control.force.body_stiffness, self._settings.cutoff_hz
        free = tuple(replace(spring, load_hz=hz) for spring in super().linear_laws())
        reflex = (0.0, self._settings.reflex)
        return (*free, *(replace(spring, contact=reflex, body=body) for spring in free))

    def force(self, motion: Motion, stiffness: float) -> Array:
        base = self._control.stiffness.base
        size = norm(motion.external)
        rest = max(size - motion.contact, 0.0)
        wanted = min(rest, self._settings.limit) / size if size > 0.0 else 0.0
        self._load += self._follow * (wanted * motion.external - self._load)
        give = min(stiffness / base, 1.0)
        force = super().force(motion, stiffness) - give * self._load
        asked = norm(motion.push)
        if asked == 0.0 or motion.contact < self._control.force.threshold:
            self._reflex = 0.0
        else:
            if stiffness >= base:
                grown = self._reflex + self._step * (asked - motion.contact)
                limit = self._settings.reflex_limit
                self._reflex = min(max(grown, -limit), limit)
            force = force + give * self._reflex * motion.push / asked
        return np.asarray(force)
