"""The paper's loop as it is printed, kept to show why it cannot be meant."""

from __future__ import annotations

from tonus.config.schema.control import TensionLoop
from tonus.runtime.control.controllers.bio import Bio


class Eq9Literal(Bio):
    """`bio` over eq. (9) word for word while ACTIVE: torque proportional to the tension error,
    without feed-forward, damping or integral. Half a per cent of error needs a gain of 199; with
    two ticks of delay such a loop oscillates (`tonus.tools.margins.tension_loop`). For the lab
    only."""

    @property
    def tension_loop(self) -> TensionLoop:
        loop = self._control.tension_loop
        bare = {"feed_forward": 0.0, "integral": 0.0, "rate_damping": 0.0, "lead": 0.0}
        return loop.model_copy(update=bare | {"proportional": self._control.eq9_literal.gain})
