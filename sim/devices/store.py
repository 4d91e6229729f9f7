"""Storing and restoring parameters: 0x1010 and 0x1011 of CiA 301, subindex 1 (all)."""

from __future__ import annotations

from collections.abc import Callable

from tonus.sim.devices.objects import CANNOT_STORE, HARDWARE, AbortError, ObjectDictionary

SAVE = 0x65766173
LOAD = 0x64616F6C


def connect_store(objects: ObjectDictionary, works: Callable[[], bool] = lambda: True) -> None:
    """``works``: whether the memory can be written. What is restored counts from the next reset."""

    def save(value: int) -> None:
        if value != SAVE:
            raise AbortError(CANNOT_STORE)
        if not works():
            raise AbortError(HARDWARE)
        objects.save()

    def load(value: int) -> None:
        if value != LOAD:
            raise AbortError(CANNOT_STORE)
        objects.forget()

    for index, write in ((0x1010, save), (0x1011, load)):
        entry = objects.find(index, 1)
        entry.write = write
        entry.read = lambda: 1
