"""Writes a project from the template beside this file."""

from __future__ import annotations

import re
from pathlib import Path

from tonus.tools.draft import write_whole
from tonus.tools.errors import ToolError
from tonus.tools.folders import make_folder
from tonus.tools.start_configuration import write_configuration

TEMPLATE = Path(__file__).resolve().parent / "template"
ROBOT = "robot"
_NAMED = "README.md"
_SUFFIX = ".template"
"""of what would be a module, or a setting of git, in the template's own place"""


def write_project(folder: Path, like: str) -> list[Path]:
    """Write a project whose robot is like the shipped configuration ``like`` to a folder that is
    new or empty; gives its files, the README first. Raises `ToolError` and `ConfigError`."""
    if folder.is_dir() and any(folder.iterdir()):
        raise ToolError(f"{folder}: is not empty; name a new folder")
    robot = write_configuration(folder / ROBOT, like)
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", folder.resolve().name) or "robot"
    written = []
    for source in sorted(TEMPLATE.rglob("*")):
        if not source.is_file():
            continue
        place = folder / source.relative_to(TEMPLATE)
        place = place.with_name(place.name.removesuffix(_SUFFIX))
        text = source.read_text(encoding="utf-8")
        make_folder(place.parent, "choose another folder")
        write_whole(place, text.replace("{name}", name) if place.name == _NAMED else text)
        written.append(place)
    written.sort(key=lambda place: place.name != _NAMED)
    return [*written, robot[0]]
