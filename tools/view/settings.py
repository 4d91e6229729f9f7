"""How often, how much, and from whom: config/view.yaml."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import yaml

from tonus import config
from tonus.tools.documents import from_yaml

if TYPE_CHECKING:
    from tonus.config.schema.view import View

_FILE, _SHOWN = Path(config.__file__).parent / "view.yaml", "config/view.yaml"


class _AsWritten(SimpleNamespace):
    """The file's values, before they have been held against their schema."""

    def __getattr__(self, name: str) -> object:
        """One that is missing: say so as for any configuration."""
        held_against_its_schema()
        raise AttributeError(name)


@cache
def settings() -> View:
    """Read once, and without a schema, for which a first picture would wait a tenth of a second.
    Raises `ConfigError` for what is no number; what a number may be
    `held_against_its_schema` knows."""
    try:
        written = from_yaml(_FILE.read_bytes())
    except (OSError, yaml.YAMLError):
        written = None
    if not isinstance(written, dict) or not all(map(_is_number, written.values())):
        return held_against_its_schema()
    return cast("View", _AsWritten(**written))


def held_against_its_schema() -> View:
    """All of it. Raises `ConfigError`."""
    from tonus.config.checked import validated
    from tonus.config.document import read
    from tonus.config.schema.view import View

    return validated(read(_FILE, _SHOWN), View)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
