"""Something done again and again on the running loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable


def every(seconds: float, action: Callable[[], object]) -> Callable[[], None]:
    """Do it again and again on the running loop; returns what ends that."""

    async def repeat() -> None:
        while True:
            await asyncio.sleep(seconds)
            action()

    task = asyncio.get_running_loop().create_task(repeat())

    def end() -> None:
        task.cancel()

    return end
