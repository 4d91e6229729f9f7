"""What a rule of `tonus check` found."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One rule's outcome: ``text`` has the figure, ``remedy`` what to do should it have failed."""

    rule: str
    ok: bool
    where: str
    """dotted key"""
    text: str
    remedy: str
