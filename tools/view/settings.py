"""How often, how much, and from whom: config/view.yaml."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from tonus import config
from tonus.config.checked import validated
from tonus.config.document import read
from tonus.config.schema.view import View


@cache
def settings() -> View:
    """Read once, without the schema of all the rest: a first picture does not wait for that."""
    return validated(read(Path(config.__file__).parent / "view.yaml", "config/view.yaml"), View)
