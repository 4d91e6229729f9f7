"""A lab of which only some nodes are emulated."""

from __future__ import annotations

import pytest
from lab_bench import Bench

from tonus.config.schema.lab import LabScript
from tonus.sim.errors import LabError

NODES = frozenset({("can0", 1), ("can3", 25)})
PULL = {"kind": "unplug", "channel": "can3", "node": 25, "at": 0.01}


def test_the_script_begins_when_the_drives_that_are_emulated_are_enabled() -> None:
    script = LabScript.model_validate({"faults": [PULL]})
    with Bench(script=script, nodes=NODES) as bench:
        bench.wait(5)
        bench.configure("can0", 1)
        bench.send("can0", 0x000, b"\x01\x00")
        for word in (0x06, 0x06, 0x0F, 0x0F):
            bench.tick(word)
        contact = bench.lab.nodes["can3", 25]
        assert bench.lab.drives[0].enabled
        assert bench.lab.plant.powered.tolist() == [True] + [False] * 7
        bench.wait(8)
        assert contact.plugged
        bench.wait(4)
        assert not contact.plugged


def test_a_scenario_that_needs_a_node_that_is_elsewhere_is_refused() -> None:
    script = LabScript.model_validate({"faults": [PULL]})
    with pytest.raises(LabError, match="there is no node 25 on channel 'can3'"):
        Bench(script=script, nodes=NODES - {("can3", 25)})


def test_a_load_is_played_where_no_drive_is_emulated() -> None:
    """Nothing tells whether the others have power."""
    points = [{"at": 0.0, "force": 0.0}, {"at": 0.002, "force": 20.0}, {"at": 1.0, "force": 20.0}]
    load = {"direction": (1, 0, 0), "point": (0, 0, 0), "profile": points}
    with Bench(
        script=LabScript.model_validate({"load": load}), nodes=NODES - {("can0", 1)}
    ) as bench:
        bench.wait(10)
        assert bench.lab.plant.load_wrench[0] == pytest.approx(20.0)
