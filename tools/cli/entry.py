"""Where a command's process begins: nothing is loaded yet, and an interrupt ends it at once."""

from __future__ import annotations

import os
import signal


def main() -> None:
    """Entry point of the console script."""
    before = signal.signal(signal.SIGINT, lambda *_: os._exit(1))
    from tonus.tools.cli import main as commands  # click alone takes longer than a quick hand

    signal.signal(signal.SIGINT, before)
    commands.main()
