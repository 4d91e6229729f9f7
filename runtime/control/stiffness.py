"""The bio-inspired stiffness law. What comes of it is for envelope and limiter to say."""

from __future__ import annotations

from dataclasses import dataclass

from tonus.config.schema.control import StiffnessLaw

GAINS = ("deviation_gain", "velocity_gain", "force_gain")


@dataclass
class LawTerms:
    """One evaluation: relative increases, and the stiffness they make (N/m)."""

    deviation: float = 0.0
    velocity: float = 0.0
    force: float = 0.0
    stiffness: float = 0.0


class Law:
    """Eq. (3) and eq. (10) in the normalised reading:

    K = K0 (1 + g_e |e|/e_ref + g_v |v|/v_ref + g_F |F|/F_ref), each ratio clipped to 1,
    K clipped to [K_min, K_max]. A profile is a named set of gains (docs/paper.md, rows 2 to 5):
    eq. (3) has no deviation term, so the profile `table1_eq3` ignores that gain.
    """

    def __init__(self, config: StiffnessLaw) -> None:
        self._config = config
        deviation_gain = config.deviation_gain if config.profile == "eq10" else 0.0
        self.gains = [deviation_gain, config.velocity_gain, config.force_gain]
        """in force, in the order of `GAINS`; `Tuning` may move them"""
        self.terms = LawTerms()

    def __call__(self, deviation: float, velocity: float, force: float) -> float:
        """Stiffness (N/m) for the norms of deviation (m), velocity (m/s) and force (N)."""
        c, terms = self._config, self.terms
        deviation_gain, velocity_gain, force_gain = self.gains
        terms.deviation = deviation_gain * min(deviation / c.deviation_reference, 1.0)
        terms.velocity = velocity_gain * min(velocity / c.velocity_reference, 1.0)
        terms.force = force_gain * min(force / c.force_reference, 1.0)
        rise = terms.deviation + terms.velocity + terms.force
        terms.stiffness = min(max(c.base * (1.0 + rise), c.minimum), c.maximum)
        return terms.stiffness
