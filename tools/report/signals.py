"""The table of signals in docs/log.md, printed from the topics themselves.

python -m tonus.tools.report.signals > docs/log.md
"""

from __future__ import annotations

import sys

from tonus.runtime.signals import SCHEMA_VERSION, TOPICS
from tonus.runtime.topics import Topic
from tonus.tools.run.truth import TOPIC as TRUTH

_HEAD = """# The log

For those who evaluate runs: every topic and signal of a log with type, unit and meaning, and the
commands that read a log.

One MCAP file a run. Every topic below is a ROS 2 message in CDR, once a cycle, its definition
inside the file; besides them `/tonus/events` (what a person wants to know), and `/can/<channel>`
with every raw frame as `can_msgs/msg/Frame`. Configuration, scenario and installed packages are
attached; metadata `tonus` holds versions, seed and, in real time, host facts. `log_time` is UTC in
real time and starts at 0 in virtual time. In Python,
`tonus.tools.log.open("run.mcap")["/tonus/tension"]` is a numpy array of them all.

    tonus log info FILE...     what, when, how long, states, faults, topics, rates, gaps, damage
    tonus log report FILE      one HTML page: verdict, plots, the paper's Figure 1, events; offline
    tonus log compare FILE...  the indicators of the paper's Table 3, for any runs, with spread
    tonus log replay FILE...   the recorded inputs once more, every output compared bit for bit
    tonus log identify FILE... the robot's parameters from its own records (identification.md)
    tonus log timing FILE...   budgets in YAML, each line passes or fails (config/budgets)
    tonus log recover FILE     a damaged file written anew; the source stays as it is
    tonus log export FILE... --format csv|parquet|asc|blf
    tonus log layout foxglove|plotjuggler   plots arranged for a viewer

A run may lie in several files: after `recording.rotate_mb` or `rotate_s` the recorder goes on in
`run.2.mcap` and so on, as it does when it died and was started again (`recorder_restarted`). Each
is complete in itself; opening `run.mcap` reads them all as one, and so do several FILEs. When the
disk has no room (`keep_free_mb`) control goes on and recording does not (`recording_stopped`, and
`unrecorded` in summary.json); it resumes in another file when there is room, with what the ring
still holds (`ring_s`). Files are never deleted, unless `keep_files` says how many are to stay.

Thirty times a second (`recording.viewer_hz`) the robot is also there as viewers know it: `/tf`
(`base` to `platform`), `/viewer/pose` and `/viewer/desired` (PoseStamped), `/viewer/winches`
(JointState), `/viewer/markers` (MarkerArray: frame, platform, and cables from blue at T_min over
grey at pretension to orange at T_max, black when slack); 0.3 GB an hour before compression.

In Python there are also
`log.between(1.5, 2.0)` (s since the start), `log.join("/tonus/pose", "/tonus/truth")` (one
record a tick), `log.batches(topics)` (a chunk at a time) and `tonus.tools.log.tables` (Arrow,
pandas). A damaged file is read up to the damage, which `log.damage` names.

A report reads the run in pieces of half a minute: of the whole it holds 50 bytes a cycle. Ten
minutes take 0.45 GB and 16 to 20 s of processor time. Its spectra are of the first minute of the
longest ACTIVE, at most. Of damaged files `make robust` makes 500 and has every command read them.

A replay needs every input of the cycle: `angle`, `torque`, `sampled_ns`, `doubt_ns`, `statusword`,
`error_code`, `age` and `state` of /tonus/drives, `raw`, `age` and `status` of /tonus/force_cells,
`position`, `quaternion`, `delay`, `sequence` and `fresh` of /tonus/tracker, `operator` and `select`
of /tonus/state, and the tick. `inputs` of /tonus/state is a checksum of them: an input that was
altered is found in its tick, even one that no output heeds. `/tonus/keyframe` holds the
cycle's whole state every `recording.keyframe_s`; a replay of later ticks, or of what follows on
missing records, begins there. `--with CONFIG` tells what another configuration would have commanded
on the same inputs, with the sequence of the recorded one; the robot did not answer to that.

An hour at 1 kHz takes 5.1 GB (1.4 kB a cycle, of which the lab's truth is a third), and 8.0 GB with
raw frames of four CAN channels (`recording.raw_frames`). Two thirds are the signals' noise, which
nothing packs: outputs are compared to the last bit, so they stay float64; host latencies are
float32, states and ages 8 and 16 bits. The index that viewers seek by takes 16 bytes a message.

This page is printed from the record's own table (`python -m tonus.tools.report.signals`); schema
version
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
