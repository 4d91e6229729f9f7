"""Make the golden log of the present schema version: a short run, thinned to the ticks round its
changes of state. Run it once, when SCHEMA_VERSION goes up: python -m tests.replay.make_golden"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "hil"))

from tests.composed import configured, virtual
from tonus.runtime.signals import SCHEMA_VERSION
from tonus.tools.log import Log

GOLDEN = Path(__file__).parent / "golden"
BEFORE, AFTER = 4, 8
"""ticks kept round a change"""


def kept(log: Log) -> set[int]:
    """log_time of the cycles to keep."""
    state, times = log["/tonus/state"]["state"], log.times("/tonus/state")
    changes = [0, *np.flatnonzero(np.diff(state)) + 1, len(state)]
    chosen = {n for change in changes for n in range(change - BEFORE, change + AFTER)}
    return {int(times[n]) for n in chosen if 0 <= n < len(times)}


def thin(source: Path, target: Path, times: set[int]) -> None:
    with source.open("rb") as file, target.open("wb") as out:
        reader = make_reader(file)
        writer = Writer(out, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="tonus")
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages():
            event = channel.topic == "/tonus/events"
            if not event and message.log_time not in times:
                continue
            if schema is not None and schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[channel.schema_id]
                )
            writer.add_message(
                channels[channel.id],
                message.log_time,
                message.data,
                message.publish_time,
                message.sequence,
            )
        for attachment in reader.iter_attachments():
            writer.add_attachment(
                attachment.create_time,
                attachment.log_time,
                attachment.name,
                attachment.media_type,
                attachment.data,
            )
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        writer.finish()


def main() -> None:
    config, scenario = configured("config/direct.yaml", "hold", duration=0.1)
    with tempfile.TemporaryDirectory() as folder:
        _, log = virtual(config, scenario, Path(folder))
        thin(log.path, GOLDEN / f"v{SCHEMA_VERSION}.mcap", kept(log))


if __name__ == "__main__":
    main()
