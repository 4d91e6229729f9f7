"""The table of signals in docs/log.md, printed from the topics themselves.

python -m tonus.tools.report.signals > docs/log.md
"""

from __future__ import annotations

import sys

from tonus.runtime.signals import SCHEMA_VERSION, TABLE
from tonus.runtime.topics import Per, Topic
from tonus.tools.run.truth import TOPIC as TRUTH

_HEAD = """# The log

For those who evaluate runs: every topic and signal of a log with type, unit and meaning, and the
commands that read a log.

A run has one MCAP file. Every topic below is a ROS 2 message in CDR, one per cycle, with its
definition in the file. The file also has `/tonus/events` ([events.md](events.md)) and, with
`recording.raw_frames`, `/can/<channel>` with every raw frame as `can_msgs/msg/Frame`.
Configuration, scenario and installed packages are attached; the metadata `tonus` has versions, seed
and, in real time, facts about the host. `log_time` is UTC in real time and starts at 0 in virtual
time. In Python, `tonus.open_log("run.mcap")["/tonus/tension"]` is an array with one row per cycle.
*n* is the number of the robot's cables; the definitions in a log have the figure.

    tonus log info FILE...     time, duration, states, faults, topics, rates, gaps, damage
    tonus log figure FILE...   one picture as png, svg or pdf; several runs in one; --list
    tonus log report FILE      one HTML page: verdict, plots, the paper's Figure 1, events; offline
    tonus log compare FILE...  the indicators of the paper's Table 3, for any runs, with spread
    tonus log replay FILE...   feeds the recorded inputs to control; compares outputs bit for bit
    tonus log identify FILE... the robot's parameters from its own records (identification.md)
    tonus log timing FILE...   budgets in YAML, each line passes or fails (config/budgets)
    tonus log recover FILE     writes the intact records of a damaged file to another file
    tonus log export FILE... --format csv|parquet|mat|asc|blf   tables; --merge: one; bus frames
    tonus log layout foxglove|plotjuggler   plots arranged for a viewer

A run may have several files: after `recording.rotate_mb` or `rotate_s` the recorder continues in
`run.2.mcap` and so on, and also after a restart (`recorder_restarted`). Each file is complete in
itself; opening `run.mcap` reads all of them as one log, and so does a list of FILEs. When the disk
is full (`keep_free_mb`) control goes on and recording stops (`recording_stopped`, and `unrecorded`
in summary.json); recording resumes in another file when there is space, with the records that the
ring still holds (`ring_s`). Files are deleted only if `keep_files` limits their number.

Thirty times a second (`recording.viewer_hz`) the log has the robot in standard messages: `/tf`
(`base` to `platform`), `/viewer/pose` and `/viewer/desired` (PoseStamped), `/viewer/winches`
(JointState), `/viewer/markers` (MarkerArray: frame, platform, and cables from blue at T_min over
grey at pretension to orange at T_max, black when slack); 0.3 GB an hour before compression.

An export has the name of each state, fault, stop mode, command or level beside its number
(`state` 5, `state_name` ACTIVE). A `.mat` file is MATLAB's version 5 (MATLAB, Octave, scipy): a
struct for each topic, `s = load('run.mat')`, `s.tonus_tension.measured` with a row for each
message, `time` in s since the log's first message, `units`; names are rows of characters, with
blanks behind (`cellstr`), of an array a row for each element (messages × elements × characters);
`about` has the run's metadata. What MATLAB does not allow in a name is changed to `_`.

`--merge` writes one table, `merged.csv`, `.parquet` or `.mat`, with a row for each tick and columns
`topic.field` (`tension.measured_0`; in `.mat` a struct for each topic, all with equal rows, and
`ticks`). A tick has the latest message of each topic at or before its own time: a topic that comes
less often is held at its last value. A topic that is not of the control cycle (`truth`,
`/can/can0`) has a column `held`: seconds since that message. Ticks before the first message of any
chosen topic are left out. Without `--topics` all of `/tonus/` are in it, but events and keyframes.

An export reads a chunk of the log at a time. Ten minutes at 1 kHz (600 000 cycles, all topics) take
0.1 GB of memory as CSV, 0.3 GB as Parquet and 0.4 GB as `.mat`, and 65, 14 and 16 s of processor
time (2026-11-25). Only a `.mat` file needs more for a longer run: the names of all
axes' states, 0.5 kB a cycle while they are written. It is not compressed, and needs its own size
(1.7 GB in ten minutes) a second time on the disk meanwhile; a struct beyond 2 GB is refused, so
longer runs go out in parts (`--from`, `--to`, `--topics`).

`tonus log figure FILE --what tension --out tension.pdf` draws one of the pictures of overview and
report alone, as `.png`, `.svg` or `.pdf`; `--list` prints their names: overview, force, stiffness,
tension, error, position, speed, path (3-D), envelope, spectra, timing. Several FILEs are runs in
one picture, aligned at START (the first ACTIVE): of each the curve or two that can be compared, for
example the highest and the lowest tension. `position`, `envelope` and `spectra` show one run. Ten
minutes take 0.4 GB and 8 s of processor time.

In Python there are also
`log.between(1.5, 2.0)` (s since the start), `log.join("/tonus/pose", "/tonus/truth")` (one
record a tick), `log.batches(topics)` (a chunk at a time) and `tonus.tools.log.tables` (Arrow,
pandas). [A notebook](notebooks/first_look.md) makes a table, figures and a fit. A damaged file is
read up to the damage; `log.damage` describes it.

With `tonus[view]` installed a report begins with plots to zoom into, on one time axis, with the
states as bands and the events as marks; a click on a cable's name hides it in every panel. The
static pictures follow. The page opens offline: it holds plotly's script. Curves keep the lowest and
highest value of each of 3600 stretches of time, so its size does not grow with the run (2026-11-23:
9.0 MB for 16 s in motion, 8.0 MB for 23 minutes of `load_test`). The 3-D playback is not in it:
`tonus view FILE` shows it.

A report reads the run in chunks of half a minute and keeps 50 bytes a cycle. Ten minutes take
0.45 GB and 16 to 20 s of processor time. Its spectra use the longest ACTIVE, at most the first
minute of it. `make robust` makes 500 damaged files and reads them with every command.

A replay needs every input of the cycle: `angle`, `torque`, `sampled_ns`, `doubt_ns`, `statusword`,
`error_code`, `age` and `state` of /tonus/drives, `raw`, `age` and `status` of /tonus/force_cells,
`position`, `quaternion`, `delay`, `sequence` and `fresh` of /tonus/tracker, `operator` and `select`
of /tonus/state, `parameter` and `value` of /tonus/tuning (an older log has neither), and the tick.
`inputs` of /tonus/state is a checksum of them: an input that was
altered is found in its tick, even one that affects no output. `/tonus/keyframe` holds the
cycle's whole state every `recording.keyframe_s`; a replay of later ticks, or of what follows on
missing records, begins there. `--with CONFIG` prints what another configuration would have
commanded on the same inputs, with the sequence of the recorded one. The inputs do not react to
these commands.

An hour at 1 kHz takes 5.1 GB (1.4 kB a cycle, of which the lab's truth is a third), and 8.0 GB with
raw frames of four CAN channels (`recording.raw_frames`). Two thirds are the signals' noise, which
cannot be compressed: outputs are compared to the last bit, so they stay float64; host latencies are
float32, states and ages 8 and 16 bits. The index for seeking takes 16 bytes a message.

This page is printed from the table of signals (`python -m tonus.tools.report.signals`); schema
version
"""


_SIZES = {int(Per.CABLE): "n", int(Per.CELL): "n + 1"}


def markdown() -> str:
    """The whole page."""
    parts = [f"{_HEAD.rstrip()} {SCHEMA_VERSION}.\n"]
    parts += [_section(topic) for topic in (*TABLE, TRUTH)]
    return "\n".join(parts)


def _section(topic: Topic) -> str:
    rows = [f"## {topic.name}", "", f"{topic.doc[0].upper()}{topic.doc[1:]}.", ""]
    rows += ["| field | type | unit | meaning |", "|---|---|---|---|"]
    for field in topic.fields:
        size = f"[{_SIZES.get(field.size, field.size)}]" if field.size else ""
        rows.append(f"| {field.name} | {field.type}{size} | {field.unit} | {field.doc} |")
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    sys.stdout.write(markdown())
