"""An identification as JSON, and as YAML to paste into a configuration."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import yaml

from tonus.tools.identify.estimate import Estimate
from tonus.tools.identify.identify import Identification
from tonus.tools.identify.response import Response

_VALUES = (
    "axial_stiffness",
    "cable_damping",
    "drum_inertia",
    "viscous_friction",
    "coulomb_friction",
    "load_friction",
)
_MASSES = ("platform_mass", "moved_mass")
_EFFICIENCIES = ("efficiency_driving", "efficiency_driven")


def to_json(found: Identification) -> dict[str, Any]:
    """Everything, ready for `json.dumps`; what is not known is None."""
    return {
        "logs": [str(path) for path in found.logs],
        "estimates": [_estimate(estimate) for estimate in found.estimates],
        "responses": [_response(response) for response in found.responses],
        "notes": list(found.notes),
    }


def to_yaml(found: Identification) -> str:
    """The configuration's own keys with what was identified well enough; between the two masses the
    surer one, between the two efficiencies their mean. What axes have as their own is written
    for each of them."""
    known = [e for e in found.estimates if e.configured is not None and e.verdict != "uncertain"]
    chosen = {key: e for name in _VALUES for e in known if e.name == name for key in e.keys}
    masses = [e for name in _MASSES for e in known if e.name == name]
    if masses:
        chosen["robot.platform.mass"] = min(masses, key=lambda e: e.half_width)
    driving, driven = (
        {key: e for e in known if e.name == name for key in e.keys} for name in _EFFICIENCIES
    )
    for key in sorted(driving.keys() & driven.keys()):
        pair = driving[key], driven[key]
        chosen[key] = Estimate(
            "efficiency",
            "",
            "",
            float(np.mean([e.value for e in pair])),
            max(e.half_width for e in pair),
            pair[0].configured,
        )
    document: dict[Any, Any] = {}
    comments: dict[str, str] = {}
    for key, estimate in chosen.items():
        *sections, last = key.split(".")
        at = document
        for section in sections:
            at = at.setdefault(int(section) if section.isdecimal() else section, {})
        at[last] = rounded(estimate.value, estimate.half_width)
        was = "" if estimate.configured is None else f", was {estimate.configured:g}"
        comments[key] = f"{estimate.unit} ± {estimate.half_width:.2g}{was}".strip()
    lines = ["# Identified from " + ", ".join(str(path) for path in found.logs)]
    path: list[str] = []
    for line in yaml.safe_dump(document, sort_keys=False).splitlines():
        name = line.split(":")[0]
        path[(len(name) - len(name.lstrip())) // 2 :] = [name.strip()]
        comment = comments.get(".".join(path))
        lines.append(f"{line:<32}# {comment}" if comment else line)
    return "\n".join(lines) + "\n"


def rounded(value: float, half_width: float) -> float:
    """To the second figure of its uncertainty."""
    if not math.isfinite(half_width) or half_width <= 0.0:
        return value
    return round(value, 1 - math.floor(math.log10(half_width)))


def _estimate(estimate: Estimate) -> dict[str, Any]:
    return {
        "name": estimate.name,
        "text": estimate.text,
        "unit": estimate.unit,
        "value": _known(estimate.value),
        "half_width": _known(estimate.half_width),
        "configured": estimate.configured,
        "verdict": estimate.verdict,
        "axes": list(estimate.axes),
        "each": [_known(value) for value in estimate.each],
        "truth": estimate.truth,
        "error": None if estimate.truth is None else _known(estimate.value - estimate.truth),
    }


def _response(response: Response) -> dict[str, Any]:
    return {
        "kind": response.kind,
        "quality": response.quality,
        "lines": [
            {
                "frequency_hz": line.frequency,
                "magnitude_m_per_n": abs(line.compliance),
                "phase_deg": math.degrees(np.angle(line.compliance)),
                "half_width": line.half_width,
            }
            for line in response.lines
        ],
    }


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
