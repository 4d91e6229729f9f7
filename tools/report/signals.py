"""The table of signals in docs/log.md, printed from the topics themselves.

python -m tools.report.signals > docs/log.md
"""

from __future__ import annotations

import sys

from runtime.signals import SCHEMA_VERSION, TOPICS
from runtime.topics import Topic
from tools.truth import TOPIC as TRUTH

_HEAD = """# The log

One MCAP file a run. Every topic below is a ROS 2 message in CDR, once a cycle, its definition
inside the file; besides them `/tonus/events` (what a person wants to know), and `/can/<channel>`
with every raw frame as `can_msgs/msg/Frame`. The configuration and the scenario are attached;
metadata `tonus` holds versions, seed and, in real time, host facts. `log_time` is UTC in real time
and starts at 0 in virtual time. In Python, `tools.log.open("run.mcap")["/tonus/tension"]` is a
numpy array of them all.

This page is printed from the record's own table (`python -m tools.report.signals`); schema version
"""


def markdown() -> str:
    """The whole page."""
    parts = [f"{_HEAD.rstrip()} {SCHEMA_VERSION}.\n"]
    parts += [_section(topic) for topic in (*TOPICS, TRUTH)]
    return "\n".join(parts)


def _section(topic: Topic) -> str:
    rows = [f"## {topic.name}", "", f"{topic.doc[0].upper()}{topic.doc[1:]}.", ""]
    rows += ["| field | type | unit | meaning |", "|---|---|---|---|"]
    for field in topic.fields:
        size = f"[{field.size}]" if field.size else ""
        rows.append(f"| {field.name} | {field.type}{size} | {field.unit} | {field.doc} |")
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    sys.stdout.write(markdown())
