"""The mechanics of the lab: platform, cables, drums, motors' currents, phantom, cradle and load.

`Plant` is the door. Everything is in SI units; no device, bus or clock is known here.
"""

from tonus.sim.plant.energy import Energy
from tonus.sim.plant.plant import Plant
from tonus.sim.plant.streams import Stream, generator

__all__ = ["Energy", "Plant", "Stream", "generator"]
