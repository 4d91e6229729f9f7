"""A drive's profile against its electronic data sheet: every object it uses has to be there."""

from __future__ import annotations

from collections.abc import Iterator

from tonus.config import Config
from tonus.config.schema.drive import OPTION_OBJECTS, DriveProfile
from tonus.sim.devices.eds.sheet import Sheet, read
from tonus.sim.errors import LabError
from tonus.tools.check.finding import Finding

_REMEDY = "correct the profile, or take the drive's own EDS"
_ANY_NODE = 1
Use = tuple[int, int, int, str]
"""Index, subindex, bytes, and what is done with the object: r read, w written, m mapped."""


def check_data_sheets(config: Config) -> Iterator[Finding]:
    """One outcome for each profile with an EDS; nothing raises."""
    for each in config.fieldbus.parts:
        for key, profile in each.every_profile.items():
            if profile.eds is not None:
                problem = _problem(profile, on_can=each.heartbeats)
                yield Finding(
                    "data sheet",
                    not problem,
                    f"{key}.eds",
                    problem or f"{profile.eds.name} has every object that {profile.name} uses",
                    _REMEDY,
                )


def _problem(profile: DriveProfile, *, on_can: bool) -> str:
    """The first; "" for none."""
    assert profile.eds is not None
    try:
        sheet = read(profile.eds.name, profile.eds.text, _ANY_NODE)
    except LabError as error:
        return str(error).partition("; ")[0]
    found = (_missing(sheet, use) for use in _uses(profile, on_can=on_can))
    return next((problem for problem in found if problem), "")


def _missing(sheet: Sheet, use: Use) -> str:
    index, subindex, size, how = use
    name = f"{sheet.name}: object 0x{index:04X}:{subindex}"
    entry = sheet.entries.get((index, subindex))
    if entry is None:
        return f"{name} is not there, which the profile {_DONE[how[0]]}"
    if size and entry.kind.size != size:
        return f"{name} has {entry.kind.size} bytes, the profile has {size}"
    if "w" in how and entry.access not in ("rw", "wo"):
        return f"{name} is {entry.access}, and the profile writes it"
    if how in ("mr", "mt") and how[1] not in entry.mapping:
        way = "receive" if how == "mr" else "transmit"
        return f"{name} cannot be mapped into a {way} PDO, as the profile has it"
    return ""


_DONE = {"r": "reads", "w": "writes", "m": "maps"}


def _uses(profile: DriveProfile, *, on_can: bool) -> Iterator[Use]:
    if on_can:
        if profile.watches_master:
            yield 0x1016, 1, 4, "w"
        yield 0x1017, 0, 2, "w"
        if profile.on_communication_error is not None:
            yield 0x1029, 1, 1, "w"
    for setting in profile.settings:
        how = "r" if setting.action == "check" else "w"
        yield setting.index, setting.subindex, setting.length, how
    if profile.interpolation_ms is not None:
        yield 0x60C2, 1, 1, "w"
    for option, index in OPTION_OBJECTS.items():
        if getattr(profile.options, option) is not None:
            yield index, 0, 2, "w"
    scaling = profile.scaling
    if scaling.torque != "motor":
        yield int(scaling.torque, 16), 0, 4, "r"
    if scaling.position != "motor":
        yield int(scaling.position, 16), 1, 4, "r"
        yield int(scaling.position, 16), 2, 4, "r"
    for words, way in ((profile.rpdo, "mr"), (profile.tpdo, "mt")):
        for word in words:
            yield word >> 16, word >> 8 & 0xFF, (word & 0xFF) // 8, way
