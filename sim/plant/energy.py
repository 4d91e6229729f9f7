"""Where the plant's energy is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Energy:
    """The plant's energy accounts, all J.

    A free cable of unstretched length L0 stores E = L0 w(e) at a strain e, with w' = T, so that

        dE = T dl - (T + T e - w) dL0,    dL0 = -r dtheta.

    The drum feels the torque r T (eq. 6), whose work is r T dtheta only. The difference,
    r (T e - w) dtheta, or r T^2/(2 EA) dtheta for a linear cable, belongs to the cable wound on
    while strained; ``wound`` integrates its negative. ``total`` therefore changes by ``input_work +
    load_work - losses`` and nothing else, and ``balance`` is a constant of the motion.

    ``losses`` hold friction, gearbox, brake, cable and phantom damping, and the cradle's damping
    and friction; ``friction_losses`` and ``cable_losses`` are parts of them. ``copper_losses`` are
    none of the mechanics'.
    """

    kinetic: float
    potential: float
    strain: float
    phantom: float
    cradle: float
    wound: float
    losses: float
    friction_losses: float
    cable_losses: float
    copper_losses: float
    input_work: float
    load_work: float

    @property
    def total(self) -> float:
        stored = self.potential + self.strain + self.phantom + self.cradle
        return self.kinetic + stored + self.wound

    @property
    def balance(self) -> float:
        return self.total + self.losses - self.input_work - self.load_work
