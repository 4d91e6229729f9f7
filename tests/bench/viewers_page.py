"""A page without a browser, for `tests.bench.viewers`: python -m tests.bench.viewers_page PORT."""

from __future__ import annotations

import sys

from tests.bench.viewers import read

read(int(sys.argv[1]), flood=sys.argv[2:] == ["flood"])
