"""What the robot is: a typed schema over YAML, and the files themselves.

`load` reads one configuration and one scenario; every mistake in them is a `ConfigError` that names
file, line, key, rule and remedy. This room depends on no other.
"""

from tonus.config.errors import ConfigError
from tonus.config.loader import load
from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario

__all__ = ["Config", "ConfigError", "Scenario", "load"]
