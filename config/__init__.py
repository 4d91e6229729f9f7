"""What the robot is: a typed schema over YAML, and the files themselves.

`load` reads one configuration and one scenario; every mistake in them is a `ConfigError` that names
file, line, key, rule and remedy. This room depends on no other.

The schema takes half a second to load, for which `tonus.config.places` does not wait.
"""

from typing import TYPE_CHECKING

__all__ = ["Config", "ConfigError", "Scenario", "load"]

if TYPE_CHECKING:
    from tonus.config.errors import ConfigError
    from tonus.config.loader import load
    from tonus.config.schema.root import Config
    from tonus.config.schema.scenario import Scenario
else:
    _MODULES = {
        "Config": "schema.root",
        "ConfigError": "errors",
        "Scenario": "schema.scenario",
        "load": "loader",
    }

    def __getattr__(name: str) -> object:
        """Import a name at its first use."""
        from importlib import import_module

        if name not in _MODULES:
            raise AttributeError(f"module 'tonus.config' has no attribute {name!r}")
        found = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
        globals()[name] = found
        return found
