"""A configuration of one's own to start from: the shipped files, comments and all, in a folder of
their own, so that nothing in it includes anything outside."""

from __future__ import annotations

import os
import re
from pathlib import Path

from tonus.config.document import read
from tonus.config.loader import HERE, load, locate
from tonus.tools.draft import write_whole
from tonus.tools.errors import ToolError
from tonus.tools.folders import make_folder

MAIN, WITHOUT_FRAMES = "robot.yaml", "direct.yaml"
_SHOWN = "config"
_HEAD = """\
# {name}: written by tonus init from {source}. Adapt it to your robot, then:
#
#   tonus check {main}                 checks it; nothing is started
#   tonus run {main} --virtual         on the lab in software, faster than real time
#   tonus run {main} --serve           operated by tonus ctl
#   tonus tune all --config {direct} --land    gains for your robot
#
# A relative file name starts from the file that has it. The comment after a number has its unit; P:
# from the paper, R: our choice. For the robot itself delete the lab: line.
"""
_DIRECT_HEAD = """\
# The same robot without frames, for tonus tune and tonus paper.
"""


def write_configuration(folder: Path, like: str) -> list[Path]:
    """Write a complete configuration like the shipped one ``like`` to a folder that is new or
    empty; gives its files, the main one first. Raises `ToolError` and `ConfigError`."""
    path, shown = locate(like)
    if path.parent.resolve() != HERE.resolve():
        raise ToolError(f"{like}: is not one that comes with the package; name one in config")
    load(path)
    make_folder(folder, "choose another folder")
    if any(folder.iterdir()):
        raise ToolError(f"{folder}: is not empty; name a new folder")
    _, scenario = load(path)
    texts = _included(path, shown)
    main = texts.pop(Path(path.name))
    direct = _included(HERE / WITHOUT_FRAMES, f"{_SHOWN}/{WITHOUT_FRAMES}")
    plain = direct.pop(Path(WITHOUT_FRAMES))
    del direct[_robot_of(plain)]
    plain = plain.replace(_robot_of(plain).as_posix(), _robot_of(main).as_posix())
    texts |= direct
    played = Path("scenarios", f"{scenario.name}.yaml")
    texts[played] = (HERE / played).read_text(encoding="utf-8")
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", folder.resolve().name) or "robot"
    head = _HEAD.format(name=name, source=shown, main=folder / MAIN, direct=folder / WITHOUT_FRAMES)
    texts[Path(MAIN)] = _own(main, head, name, played)
    texts[Path(WITHOUT_FRAMES)] = _own(plain, _DIRECT_HEAD, name, played)
    for file, text in texts.items():
        make_folder((folder / file).parent, "choose another folder")
        write_whole(folder / file, text)
    others = sorted(folder / file for file in texts if file != Path(MAIN))
    return [folder / MAIN, *others]


def _included(path: Path, shown: str) -> dict[Path, str]:
    """The texts of a file and of all that it includes, by their places in the folder."""
    found = {}
    for name in read(path, shown).folders:
        place = Path(os.path.relpath(name, _SHOWN))
        found[place] = (HERE / place).read_text(encoding="utf-8")
    return found


def _robot_of(text: str) -> Path:
    """The file that a main file includes as its robot."""
    found = re.search(r"^robot: !include (\S+)", text, flags=re.MULTILINE)
    assert found is not None, "a shipped configuration includes its robot"
    return Path(found[1])


def _own(text: str, head: str, name: str, scenario: Path) -> str:
    """A main file under another name, with a head and a scenario beside it."""
    body = "".join(
        line for line in text.splitlines(keepends=True) if not line.startswith("#")
    ).lstrip("\n")
    body = re.sub(r"^name: .*$", f"name: {name}", body, flags=re.MULTILINE)
    return head + re.sub(
        r"^scenario: .*$", f"scenario: {scenario.as_posix()}", body, flags=re.MULTILINE
    )
