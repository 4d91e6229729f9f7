"""Whoever pulls at a robot stops pulling when it is stopped."""

from __future__ import annotations

from collections.abc import Callable

from tonus.config.schema.lab import LabScript
from tonus.runtime.safety.sequence import Sequence
from tonus.runtime.states import Fault, State


def releasing(
    script: Callable[[], LabScript], sequence: Sequence, release: Callable[[], None]
) -> Callable[[int], None]:
    """To be called after each tick: has the script's load end with the run. A stop for a fault is
    left to cope with it."""
    released = False

    def watch(_: int) -> None:
        nonlocal released
        if sequence.state is State.SAFE_STOP and not released:
            released = True
            pulled = script()
            loaded = pulled.load is not None or pulled.displacement is not None
            if loaded and sequence.fault is Fault.NONE:
                release()

    return watch
