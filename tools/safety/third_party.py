"""docs/third_party.md: every locked package with version, licence, use and known anomalies.

python -m tonus.tools.safety third_party > docs/third_party.md
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tonus.config.loader import load_section
from tonus.config.schema.base import Section
from tonus.tools.errors import ToolError
from tonus.tools.safety.source import ROOT

_LOCKED = re.compile(r"^([A-Za-z0-9][\w.-]*)==([^\s\\;]+)", re.MULTILINE)
_CLASSIFIER = "License :: "
_LONGEST = 60
"""characters; a longer `License` field is the licence's whole text"""
_RUNTIME, _BUILD = "runtime", "build and setup"
_HEAD = """\
# Third-party software

For those who judge or audit an installation: every package of `requirements.lock` with its
version, its licence, what it is used for, and the known anomalies that matter here.

This page is printed from the lock file, the metadata of the installed packages and
`docs/third_party.yaml` (`python -m tonus.tools.safety third_party`); `make lock` changes the
first, and a test compares them. Licences are as the packages state them.
[Dependencies](dependencies.md) says why each direct one is needed.

`runtime` packages are in the daemon's process or can be; the others are needed by the extra that
is named (`pip install tonus[view]`) or for development only. None of them was developed under a
safety standard, and Tonus claims conformity with none.

## Known anomalies

Those that concern the safety path or a result, looked at on {looked} for the versions below. They
come from the project's own tests and from the packages' documentation; the issue lists of all
packages were not searched. For a package that is not named no anomaly is known here.

"""


class Anomaly(Section):
    anomaly: str
    met: str
    """how Tonus meets it"""


class Anomalies(Section):
    """docs/third_party.yaml."""

    looked: str
    """year-month-day"""
    anomalies: dict[str, Anomaly]
    """by package"""


def locked(text: str) -> dict[str, str]:
    """Versions by package, of a lock file."""
    return dict(_LOCKED.findall(text))


def licence(package: str) -> str:
    """As the installed package states it. Raises `ToolError` where it is not installed."""
    try:
        stated = metadata.metadata(package)
    except metadata.PackageNotFoundError:
        raise ToolError(f"{package}: is locked and not installed; run make setup") from None
    for expression in stated.get_all("License-Expression") or ():
        return str(expression)
    text = "".join(str(each) for each in stated.get_all("License") or ())
    classifiers = [str(each) for each in stated.get_all("Classifier") or ()]
    named = [each.split(" :: ")[-1] for each in classifiers if each.startswith(_CLASSIFIER)]
    if named and named != ["OSI Approved"]:
        return ", ".join(named)
    first = " ".join(text.split("\n")[0].split())
    return first if 0 < len(first) <= _LONGEST else "in the package's own file"


def uses(project: Path, packages: Iterable[str]) -> dict[str, str]:
    """What each package is needed for: the first of `runtime` and the extras that leads to it."""
    tables = tomllib.loads(project.read_text(encoding="utf-8"))["project"]
    groups = {_RUNTIME: tables["dependencies"], **tables["optional-dependencies"]}
    found: dict[str, str] = {}
    for name, direct in groups.items():
        waiting = [Requirement(text) for text in direct]
        while waiting:
            requirement = waiting.pop()
            package = canonicalize_name(requirement.name)
            if package in found:
                continue
            found[package] = name
            waiting += _needed(package, requirement.extras)
    return {package: found.get(canonicalize_name(package), _BUILD) for package in packages}


def _needed(package: str, extras: set[str]) -> list[Requirement]:
    try:
        texts = metadata.requires(package) or []
    except metadata.PackageNotFoundError:
        return []  # for another platform
    wanted = extras or {""}
    return [
        each
        for each in map(Requirement, texts)
        if each.marker is None or any(each.marker.evaluate({"extra": extra}) for extra in wanted)
    ]


def page() -> str:
    """docs/third_party.md. Raises `ConfigError` and `ToolError`."""
    lock = locked((ROOT / "requirements.lock").read_text(encoding="utf-8"))
    known = load_section(ROOT / "docs" / "third_party.yaml", Anomalies)
    for package in known.anomalies:
        if package not in lock:
            raise ToolError(f"docs/third_party.yaml: {package} is not locked; remove it")
    used = uses(ROOT / "pyproject.toml", lock)
    lines = [_HEAD.format(looked=known.looked)[:-1]]
    lines += ["| package | version | anomaly | met by |", "|---|---|---|---|"]
    lines += [
        f"| {name} | {lock[name]} | {each.anomaly} | {each.met} |"
        for name, each in known.anomalies.items()
    ]
    lines += [
        "",
        "## Packages",
        "",
        "| package | version | licence | used for |",
        "|---|---|---|---|",
    ]
    lines += [
        f"| {name} | {version} | {licence(name)} | {used[name]} |" for name, version in lock.items()
    ]
    return "\n".join(lines) + "\n"
