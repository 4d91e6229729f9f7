"""One MCAP file as numpy arrays: `open` a log and index it by topic.

Messages are decoded a chunk at a time, without touching one in Python. A damaged file is read up
to the damage, which `Log.damage` names.
"""

from tools.log.log import Log, open  # noqa: A004  # as in wave.open

__all__ = ["Log", "open"]
