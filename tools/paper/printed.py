"""What the paper prints, quoted: its Tables 2 and 3 and the figures in its text."""

from __future__ import annotations

from dataclasses import dataclass

from tonus.tools.paper.case import Kind


@dataclass(frozen=True)
class Indicator:
    """A row of Table 2 or 3, and our indicator that we read it as."""

    label: str
    symbol: str
    unit: str
    key: str
    """of `metrics.measure`"""
    kinds: frozenset[Kind]
    """the tests it is taken from"""
    more_is_better: bool = False
    scale: float = 1.0
    """from SI to ``unit``"""
    floor: float = 0.0
    """in ``unit``; what lies below it counts as this much in a comparison"""


FORCE = Indicator("RMS force error", "RMSE_F", "N", "contact_force_rmse", frozenset({Kind.PRESS}))
MOMENT = Indicator("RMS moment error", "RMSE_M", "N m", "moment_rmse", frozenset({Kind.SINE}))
SETTLING = Indicator("Settling time", "T_s", "s", "settling", frozenset({Kind.MOVE}))
OVERSHOOT = Indicator(
    *("Overshoot", "M_p", "%", "overshoot_percent", frozenset({Kind.MOVE})),
    floor=1.0,
)
"""Below 1 % of a 10 mm step lies the paper's tracker, 0.1 mm: two that stay there are alike."""
PHASE = Indicator("Phase deviation", "φ", "°", "phase_lag_deg", frozenset({Kind.SINE}))
DISSIPATION = Indicator(
    "Energy dissipation, per period", "E_d", "J", "energy_per_period", frozenset({Kind.SINE})
)
EFFICIENCY = Indicator(
    "Energy efficiency", "η", "%", "efficiency_percent", frozenset({Kind.SINE}), True
)
STIFFNESS = Indicator(
    "Stiffness deviation",
    "E_keq",
    "% of K0",
    "stiffness_deviation_percent",
    frozenset({Kind.RAMP, Kind.STEP}),
)

TABLE2: tuple[tuple[Indicator, float, float, float], ...] = (
    (FORCE, 3.9, 4.2, 7.1),
    (MOMENT, 0.034, 0.037, 8.8),
    (SETTLING, 1.32, 1.36, 2.9),
    (PHASE, 4.3, 4.5, 4.7),
    (EFFICIENCY, 77.2, 76.0, 1.6),
)
"""Indicator, simulated, experimental, relative error in % as printed"""
TABLE2_R2 = (0.972, 0.970)
"""simulated, experimental"""
TABLE3: tuple[tuple[Indicator, float, float, float], ...] = (
    (FORCE, 6.8, 4.2, 38.2),
    (SETTLING, 2.00, 1.36, 32.0),
    (OVERSHOOT, 8.1, 2.9, 64.2),
    (DISSIPATION, 42.3, 30.5, 27.9),
    (EFFICIENCY, 60.2, 76.0, 26.2),
    (STIFFNESS, 0.42, 0.28, 33.3),
)
"""Indicator, PID, bio-inspired, improvement in % as printed. E_keq is in N/m there."""

SLOPE = 420.0
"""N/m, section 4"""
CONTACT_LIMIT = 25.0
"""N, abstract"""

OURS: tuple[Indicator, ...] = (
    Indicator(
        "Tracking error, RMS", "RMSE_x", "mm", "position_rmse", frozenset({Kind.SINE}), False, 1e3
    ),
    Indicator(
        "25 N step: deviation, peak",
        "e_peak",
        "mm",
        "load_deviation_peak",
        frozenset({Kind.STEP}),
        False,
        1e3,
    ),
    Indicator(
        "25 N step: deviation, end",
        "e_end",
        "mm",
        "load_deviation_end",
        frozenset({Kind.STEP}),
        False,
        1e3,
    ),
    Indicator("25 N step: settling", "T_s", "s", "load_settling", frozenset({Kind.STEP})),
    Indicator(
        "100 N ramp: deviation, peak",
        "e_peak",
        "mm",
        "load_deviation_peak",
        frozenset({Kind.RAMP}),
        False,
        1e3,
    ),
    Indicator(
        "100 N ramp: deviation, end",
        "e_end",
        "mm",
        "load_deviation_end",
        frozenset({Kind.RAMP}),
        False,
        1e3,
    ),
    Indicator("Contact force, peak", "F_c", "N", "contact_peak", frozenset({Kind.CONTACT})),
    Indicator(
        "Mean K_eq under load",
        "K_eq",
        "kN/m",
        "k_eq_mean",
        frozenset({Kind.RAMP, Kind.STEP}),
        False,
        1e-3,
    ),
    Indicator("Control effort", "RMS τ̇", "N m/s", "effort", frozenset({Kind.SINE})),
    Indicator(
        "Efficiency, drive by drive",
        "η_d",
        "%",
        "drive_efficiency_percent",
        frozenset({Kind.SINE}),
        True,
    ),
)
"""Beside the paper's: what its table leaves out and a judgement needs"""
