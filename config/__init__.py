"""What the robot is: a typed schema over YAML, and the files themselves.

`load` reads one configuration and one scenario; every mistake in them is a `ConfigError` that names
file, line, key, rule and remedy. This room depends on no other.
"""

from config.errors import ConfigError
from config.loader import load
from config.schema.root import Config
from config.schema.scenario import Scenario

__all__ = ["Config", "ConfigError", "Scenario", "load"]
