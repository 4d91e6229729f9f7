"""A run of which less is recorded is the same run: what is recorded is equal bit for bit, and so
are its events."""

from __future__ import annotations

import numpy as np
import pytest

from tests.loop import QUICK
from tonus.config import load
from tonus.config.schema.robot_faults import ShiftedTracker, TrackerHidden
from tonus.drivers.devices.tracker import TrackerInput
from tonus.drivers.direct import DirectFieldbus
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.daemon import Daemon
from tonus.runtime.operation.operator import Script
from tonus.runtime.ports import ALL, LEFT_OUT, Recorded
from tonus.runtime.signals import cycle_dtype
from tonus.runtime.states import State
from tonus.runtime.timing import clock
from tonus.runtime.timing.scheduler import VirtualPacing
from tonus.sim.lab.engine import Lab
from tonus.tools.run.kept import Kept

Told = list[tuple[object, ...]]
PARTS = {
    "every tick, lean": Recorded(lean=True),
    "one tick in seven": Recorded(stride=7),
    "one tick in ten, lean": Recorded(stride=10, lean=True),
    "ACTIVE alone": Recorded(states=frozenset({State.ACTIVE})),
}

REGULATED = [int(state) for state in (State.PRETENSION, State.HOLD, State.ACTIVE)]


def played(recorded: Recorded) -> tuple[Kept, Told]:
    """A second of a sine, in which the tracker is hidden and comes back 2 mm beside."""
    config, scenario = load("config/direct.yaml", scenario="sine_x", overrides=QUICK)
    faults = (
        TrackerHidden(at=0.1, duration=0.3),
        ShiftedTracker(at=0.4, shift=(0.002, 0.0, 0.0)),
    )
    script = scenario.lab.model_copy(update={"faults": faults})
    kept, told = Kept(cycle_dtype(config.robot.cables)), Told()

    async def main() -> None:
        time = clock.loop_clock()
        lab = Lab(config, script, seed=3, clock=time, truth=lambda _record, _ns: None)
        image = ProcessImage(config.robot.cables)
        daemon = Daemon(
            config,
            scenario,
            DirectFieldbus(config, image, lab.direct, time),
            TrackerInput(image, lab.tracker),
            Script(1.0),
            ring=kept,
            events=lambda *event: told.append(event),
            stopwatch=clock.Stopwatch(running=False),
            recorded=recorded,
        )
        await daemon.run(VirtualPacing, lambda _: None, lambda: None)

    clock.run(main(), virtual=True)
    return kept, told


@pytest.fixture(scope="module")
def whole() -> tuple[Kept, Told]:
    kept, told = played(ALL)
    assert (kept.rows["state"]["state"] == State.ACTIVE).sum() > 900
    assert {"tracker_lost", "tracker_back"} <= {str(event[3]) for event in told}
    return kept, told


@pytest.mark.parametrize("recorded", PARTS.values(), ids=PARTS)
def test_a_part_of_the_records_is_of_the_same_run(
    recorded: Recorded, whole: tuple[Kept, Told]
) -> None:
    kept, told = played(recorded)
    everything, all_told = whole
    assert told == all_told
    period_ns = np.diff(everything.stamps[:2]).item()
    chosen = everything.stamps % (recorded.stride * period_ns) == 0
    chosen &= np.isin(everything.rows["state"]["state"], [*recorded.states])
    assert kept.stamps.tolist() == everything.stamps[chosen].tolist()
    # What a tick that does not regulate leaves as it was is of another tick.
    rows, wanted = kept.rows, everything.rows[chosen]
    regulated = np.isin(rows["state"]["state"], REGULATED)
    assert regulated.sum() * recorded.stride > (2000 if State.HOLD in recorded.states else 900)
    if recorded.lean:
        assert not rows["state"]["inputs"].any()
        assert not np.array_equal(rows["pose"]["bias"], wanted["pose"]["bias"])
    for topic in everything.rows.dtype.names or ():
        for name in everything.rows.dtype[topic].names or ():
            same = rows[topic][name][regulated], wanted[topic][name][regulated]
            equal = np.array_equal(*same, equal_nan=same[0].dtype.kind == "f")
            if not (recorded.lean and f"{topic}.{name}" in LEFT_OUT):
                assert equal, f"{topic}.{name}"
            if name == "condition":
                np.testing.assert_allclose(*same, rtol=1e-9)
