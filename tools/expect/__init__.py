"""What a recorded run has to have done: questions over a log, for tests and acceptance.

Nothing here knows of pytest. A question that is answered otherwise raises `ExpectationError`.
"""

from __future__ import annotations

from tonus.tools.expect.failure import ExpectationError
from tonus.tools.expect.found import Found
from tonus.tools.expect.run import Run
from tonus.tools.expect.signal import Signal

__all__ = ["ExpectationError", "Found", "Run", "Signal"]
