"""The truth record says what the plant is, byte by byte as its table says."""

from __future__ import annotations

import numpy as np
import pytest
from plant_setup import KELVIN_VOIGT, placed, plant, run

from tonus.sim.lab.truth import truth_dtype, truth_fields, words

TRUTH, TRUTH_FIELDS = truth_dtype(8), truth_fields(8)


def test_the_record_is_packed_in_the_tables_order_widest_first() -> None:
    widths = [np.dtype(kind).itemsize for _, kind, _, _, _ in TRUTH_FIELDS]
    assert widths == sorted(widths, reverse=True)
    size = sum(w * max(1, f[2]) for w, f in zip(widths, TRUTH_FIELDS, strict=True))
    assert TRUTH.itemsize == size
    assert TRUTH.names == tuple(name for name, *_ in TRUTH_FIELDS)
    assert len(set(TRUTH.names)) == len(TRUTH.names)


def test_every_field_is_the_plants() -> None:
    p = placed(plant(phantom=KELVIN_VOIGT), (0.02, 0.0, 0.0))
    p.velocity[:] = (0.1, 0.2, 0.3)
    run(p, 0.05)
    record = np.zeros(1, TRUTH)
    words(record)[:] = p.truth
    energy = p.energy()
    for name, _, size, _, _ in TRUTH_FIELDS:
        if name == "load":
            wanted = p.load_wrench
        elif hasattr(energy, name):
            wanted = getattr(energy, name)
        else:
            wanted = getattr(p, name)
        assert record[name][0] == pytest.approx(wanted, abs=0.0), name
        assert np.shape(record[name][0]) == ((size,) if size else ()), name
    assert record["contact_force"][0] > 0.0
    assert record["contact_penetration"][0] == pytest.approx(p.position[0])
    before = record.copy()
    run(p, 0.01)
    assert record.tobytes() == before.tobytes()
