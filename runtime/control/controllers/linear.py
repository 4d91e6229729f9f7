"""What a controller's feedback comes to for small motion along one axis."""

from __future__ import annotations

from dataclasses import dataclass

from tonus.runtime.errors import DaemonError


class NoLinearLawError(DaemonError):
    """A controller does not say what its feedback comes to, so its margins cannot be computed."""


@dataclass(frozen=True)
class LinearLaw:
    """Linear feedback at one end of a controller's range, for its margins: force on position error,
    or tension on drum angle."""

    stiffness: float = 0.0
    """N/m"""
    damping: float = 0.0
    """N s/m"""
    integral: float = 0.0
    """N/(m s)"""
    cable: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """per cable: N/m, N s/m, N/(m s)"""
    contact: tuple[float, float] = (0.0, 0.0)
    """gains on the contact force, proportional (no unit) and integral (1/s)"""
    body: float = 0.0
    """N/m, of the body in contact"""
    load_hz: float = 0.0
    """Hz, of the low-pass through which the estimated external force, less the contact's, is fed
    forward; 0: it is not"""
