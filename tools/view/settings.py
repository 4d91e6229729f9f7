"""How often, how much, and from whom: config/view.yaml."""

from __future__ import annotations

from functools import cache

from tonus.config.loader import load_view
from tonus.config.schema.view import View


@cache
def settings() -> View:
    """Read once."""
    return load_view()
