"""What a robot is, from logs of its own: masses, cables, drums, and what a load feels.

Only what the daemon itself measures is read: drum angles and torques, force cells, tracker. How,
and how far it can be trusted, is docs/identification.md.
"""

from tonus.tools.identify.estimate import Estimate
from tonus.tools.identify.identify import Identification, identify

__all__ = ["Estimate", "Identification", "identify"]
