"""The exported DBC against the frames of a run, decoded by cantools."""

from __future__ import annotations

from pathlib import Path

import cantools.database
import numpy as np
import pytest
from cantools.database.can import Database
from click.testing import CliRunner
from loop import QUICK

from tonus.drivers.process_image import AxisState
from tonus.tools.cli.export import export
from tonus.tools.testing.held import HeldFactory


@pytest.mark.tonus(overrides=QUICK)
def test_the_frames_of_a_run_decode_to_what_control_saw(
    tonus_held: HeldFactory, tmp_path: Path
) -> None:
    out = tmp_path / "can.dbc"
    result = CliRunner().invoke(export, ["dbc", "config/can.yaml", "--out", str(out)])
    assert result.exit_code == 0, result.output
    database = cantools.database.load_file(out)
    assert isinstance(database, Database)
    robot = tonus_held(at="ACTIVE")
    robot.advance(500)
    log = robot.end().log
    drives, cells, due = log["/tonus/drives"], log["/tonus/force_cells"], log.times("/tonus/drives")
    states = {state.name: int(state) for state in AxisState}
    known, compared = {message.frame_id for message in database.messages}, 0
    for channel in ("can0", "can1", "can2", "can3"):
        frames, stamps = log[f"/can/{channel}"], log.times(f"/can/{channel}")
        assert set(frames["id"].tolist()) <= known
        # Read in the tick after its time stamp.
        ticks = np.searchsorted(due, stamps)
        for row in range(len(frames) // 2, len(frames), 7):
            frame, tick = frames[row], int(ticks[row])
            message = database.get_message_by_frame_id(int(frame["id"]))
            if not message.name.endswith("TPDO1") or tick >= len(due):
                continue
            told = message.decode(frame["data"].tobytes()[: int(frame["dlc"])])
            if message.name.startswith("Axis"):
                axis = int(message.name[4])
                assert told["Position"] == pytest.approx(drives["angle"][tick, axis], abs=1e-12)
                assert told["Torque"] == pytest.approx(drives["torque"][tick, axis], abs=1e-12)
                assert states[str(told["Statusword_State"])] == drives["state"][tick, axis]
            else:
                cell = 8 if message.name.startswith("Contact") else int(message.name[4])
                assert told["Force"] == pytest.approx(cells["raw"][tick, cell], abs=1e-9)
            compared += 1
    assert compared > 500
