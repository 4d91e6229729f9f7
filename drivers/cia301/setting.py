"""What a device must hold in its object dictionary, as data, and how it gets there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from tonus.drivers.errors import DriverError


class Kind(Enum):
    STORE = "written unless it is there already, then read back"
    COMMAND = "written and not read back, because it acts"
    CHECK = "only read and compared"


@dataclass(frozen=True)
class Setting:
    """One object's required value; ``size`` in bytes, ``why`` completes "this is ..."."""

    index: int
    subindex: int
    value: int
    size: int
    why: str
    kind: Kind = Kind.STORE

    @property
    def data(self) -> bytes:
        return self.value.to_bytes(self.size, "little", signed=self.value < 0)

    @property
    def object(self) -> str:
        return f"0x{self.index:04X}:{self.subindex}"


class ObjectAccess(Protocol):
    """Reads and writes objects of one device. Raises `SdoError`."""

    async def read(self, index: int, subindex: int) -> bytes: ...

    async def write(self, index: int, subindex: int, data: bytes) -> None: ...


class SettingError(DriverError):
    """A device does not hold what it was told, or is not what it should be."""


async def apply(access: ObjectAccess, settings: Sequence[Setting]) -> None:
    """Bring a device to hold ``settings``, in order. Raises `SettingError` or `SdoError`.

    A value that is already right is not written: some objects, an encoder's resolution among them,
    lose the position when they are written.
    """
    for setting in settings:
        if setting.kind is Kind.COMMAND:
            await access.write(setting.index, setting.subindex, setting.data)
            continue
        found = await access.read(setting.index, setting.subindex)
        if found == setting.data:
            continue
        if setting.kind is Kind.STORE:
            await access.write(setting.index, setting.subindex, setting.data)
            found = await access.read(setting.index, setting.subindex)
        if found != setting.data:
            raise SettingError(
                f"{setting.object} ({setting.why}) reads {_shown(found, setting)}, "
                f"not {setting.value}"
            )


def _shown(found: bytes, setting: Setting) -> str:
    if len(found) != setting.size:
        return f"{len(found)} bytes instead of {setting.size}"
    return str(int.from_bytes(found, "little", signed=setting.value < 0))
