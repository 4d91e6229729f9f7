"""What a log says of where it comes from: versions, configuration, scenario, host."""

from __future__ import annotations

import functools
import json
import os
import platform
from collections.abc import Sequence
from importlib.metadata import distributions, version
from typing import Any

import yaml
from pydantic import BaseModel

from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.runtime.signals import SCHEMA_VERSION
from tonus.tools.run import fieldbuses

_LIBRARIES = (
    *("clarabel", "daqp", "filterpy", "mcap", "numba", "numpy", "python-can", "scipy", "tonus"),
)

SCRIPT_START = "script_start_ns"
"""metadata of a log that begins later: time zero of the scenario's faults"""


def metadata(config: Config, scenario: Scenario, *, seed: int, virtual: bool) -> dict[str, str]:
    """The same for the same run, on whatever machine."""
    return {
        **_versions(),
        "version.python": platform.python_version(),
        "config": config.name,
        "controller": config.control.controller,
        "scenario": scenario.name,
        "schema_version": str(SCHEMA_VERSION),
        "seed": str(seed),
        "pacing": fieldbuses.pacing_name(config, virtual=virtual),
        "time": "virtual" if virtual else "real",
    }


def attachments(config: Config, scenario: Scenario, others: Sequence[Scenario]) -> dict[str, bytes]:
    """Files that the run can be made again from; ``others`` are scenarios to be chosen in it."""
    catalogue = {}
    if others:
        scenarios = [each.model_dump(mode="json") for each in others]
        catalogue["catalogue.yaml"] = _yaml({"scenarios": scenarios})
    return {
        "config.yaml": _of_model(config),
        "environment.txt": environment(),
        "scenario.yaml": _of_model(scenario),
        **catalogue,
    }


def host() -> dict[str, str]:
    """Facts about this machine, for logs in real time only."""
    return {
        "host.kernel": platform.release(),
        "host.machine": platform.machine(),
        "host.processors": str(os.cpu_count()),
    }


@functools.cache
def _versions() -> dict[str, str]:
    return {f"version.{name}": version(name) for name in _LIBRARIES}


@functools.cache
def environment() -> bytes:
    """Every installed distribution with its version, as pip takes them."""
    found = {each.metadata["Name"].lower(): each.version for each in distributions()}
    return "".join(f"{name}=={found[name]}\n" for name in sorted(found)).encode()


def _of_model(model: BaseModel) -> bytes:
    return _of_json(json.dumps(model.model_dump(mode="json")))


@functools.lru_cache(maxsize=16)
def _of_json(text: str) -> bytes:
    """Most runs of a process have the same configuration, and YAML is slow to write."""
    return _yaml(json.loads(text))


def _yaml(data: Any) -> bytes:
    return yaml.safe_dump(data, sort_keys=True).encode()
