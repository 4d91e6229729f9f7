"""Stand-in."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from tools.paper.results import Results


def publish(results: Results, out: Path, say: Callable[[str], None]) -> dict[str, Any]:
    return {"rows": len(results.rows)}
