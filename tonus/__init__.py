"""The public API of Tonus: what `__all__` lists, described in docs/api.md, and nothing else.

A name is imported at its first use, so that ``import tonus`` itself loads no other module.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

__all__ = [
    "Config",
    "ConfigError",
    "Controller",
    "DriveProfile",
    "Lab",
    "LabError",
    "LinearLaw",
    "Log",
    "Motion",
    "Order",
    "Result",
    "Scenario",
    "ToolError",
    "faults",
    "fieldbus",
    "load",
    "open_log",
    "run",
]

if TYPE_CHECKING:
    from tonus import faults, fieldbus
    from tonus.config import Config, ConfigError, Scenario, load
    from tonus.config.schema.drive import DriveProfile
    from tonus.runtime.control.controllers import Controller, LinearLaw, Motion
    from tonus.sim.errors import LabError
    from tonus.sim.lab.engine import Lab
    from tonus.tools.errors import ToolError
    from tonus.tools.log import Log
    from tonus.tools.log import open as open_log
    from tonus.tools.run.composer import Order, Result, run
else:
    _MODULES = {
        "tonus.config": ("Config", "ConfigError", "Scenario", "load"),
        "tonus.config.schema.drive": ("DriveProfile",),
        "tonus.runtime.control.controllers": ("Controller", "LinearLaw", "Motion"),
        "tonus.sim.errors": ("LabError",),
        "tonus.sim.lab.engine": ("Lab",),
        "tonus.tools.errors": ("ToolError",),
        "tonus.tools.log": ("Log", "open_log"),
        "tonus.tools.run.composer": ("Order", "Result", "run"),
    }
    _MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}
    _OTHER_NAME = {"open_log": "open"}

    def __getattr__(name: str) -> object:
        """Import a public name at its first use."""
        from importlib import import_module

        if name in ("faults", "fieldbus"):
            return import_module(f"tonus.{name}")
        if name not in _MODULE_OF:
            raise AttributeError(f"module 'tonus' has no attribute {name!r}")
        found = getattr(import_module(_MODULE_OF[name]), _OTHER_NAME.get(name, name))
        globals()[name] = found
        return found

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
