"""A run without frames is the run with frames: within noise as shipped, and bit for bit when both
sample at the same instant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.composed import configured, virtual
from tonus.runtime.signals import TABLE
from tonus.sim.can.wire.timing import frame_bits
from tonus.tools.log import Log

pytestmark = pytest.mark.wide

SYNC = 0x080
START_NS = 2_000_000_000
"""Both runs tick from here, whatever their bring-up takes."""


def _log(path: str, tmp_path: Path, overrides: dict[str, object] | None = None) -> Log:
    config, scenario = configured(path, "sine_z", duration=1.0, overrides=overrides)
    out = tmp_path / path.replace("/", "_")
    result, log = virtual(config, scenario, out, start_ns=START_NS)
    assert not result.outcome.fault, result.outcome.reason
    return log


def _offset_us() -> float:
    """From the start of a tick to the end of its SYNC, when every device samples."""
    return float(frame_bits(SYNC, 0, b""))


def test_bit_for_bit_when_the_sampling_instants_are_equal(tmp_path: Path) -> None:
    framed = _log("config/can.yaml", tmp_path)
    direct = _log("config/direct.yaml", tmp_path, {"fieldbus.sample_offset_us": _offset_us()})
    count = len(framed["/tonus/state"])
    assert count > 2000
    assert len(direct["/tonus/state"]) == count
    for topic in TABLE:
        if topic.name == "/tonus/timing":
            continue
        ours, theirs = framed[topic.name], direct[topic.name]
        for name in ours.dtype.names or ():
            assert np.array_equal(ours[name], theirs[name]), f"{topic.name}.{name}"


@pytest.mark.long
def test_within_noise_as_shipped(tmp_path: Path) -> None:
    framed, direct = (_log(path, tmp_path) for path in ("config/can.yaml", "config/direct.yaml"))
    for log in (framed, direct):
        log.load()
    rms = []
    for log in (framed, direct):
        pose = log["/tonus/pose"]
        active = log["/tonus/state"]["state"] == 5
        error = (pose["desired_position"] - pose["position"])[active]
        rms.append(float(np.sqrt(np.mean(error**2))))
    assert abs(rms[0] - rms[1]) < 0.1 * rms[0] + 2e-5
