"""Spring and damper at a constant stiffness: what adaptation is compared with."""

from __future__ import annotations

from runtime.controllers.base import Controller, Motion


class Pd(Controller):
    """Operational-space PD at the law's base stiffness."""

    def stiffness(self, motion: Motion) -> float:  # noqa: ARG002
        return self._control.stiffness.base


class PdMatched(Controller):
    """The same as stiff as `bio` is on average, so that only adaptation is left to compare."""

    def stiffness(self, motion: Motion) -> float:  # noqa: ARG002
        return self._control.pd_matched.stiffness
