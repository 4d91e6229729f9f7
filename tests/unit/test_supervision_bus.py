"""The supervisor's own bus on a channel."""

from __future__ import annotations

import pytest

from tonus.tools.errors import ToolError
from tonus.tools.run.supervision import open_bus


def test_a_channel_that_cannot_be_opened_is_named() -> None:
    with pytest.raises(ToolError, match=r"can7 cannot be opened on interface nowhere: .*doctor"):
        open_bus("nowhere", "can7", 1_000_000)
