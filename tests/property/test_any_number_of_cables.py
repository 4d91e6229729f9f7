"""What is made for a number of cables, for every number that a robot may have."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from tonus.config import load
from tonus.config.schema.robot import LEAST_CABLES, MOST_CABLES, Geometry
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.control.distribution import TensionDistribution
from tonus.runtime.control.kinematics import Kinematics
from tonus.runtime.signals import CycleRecord, cycle_dtype, topics
from tonus.runtime.topics import Topic, from_json, to_json
from tonus.sim.lab.truth import truth_dtype
from tonus.sim.plant.layout import parameters_dtype, state_dtype
from tonus.tools.check.feasibility import poses, reserves

CONFIG, _ = load("config/direct.yaml")
ROBOT, TENSION = CONFIG.robot, CONFIG.control.tension
ANY = range(LEAST_CABLES, MOST_CABLES + 1)
LENGTH = ROBOT.geometry.moment_length


def geometry(cables: int, seed: int) -> Geometry:
    """Anchors anywhere round a platform."""
    random = np.random.default_rng([cables, seed])
    frame = random.normal(size=(cables, 3))
    frame /= np.linalg.norm(frame, axis=1, keepdims=True)
    platform = 0.15 * random.normal(size=(cables, 3))
    return Geometry(frame=frame.tolist(), platform=platform.tolist(), moment_length=LENGTH)


@pytest.mark.parametrize("cables", ANY)
def test_every_input_of_the_image_is_in_its_checksum(cables: int) -> None:
    image = ProcessImage(cables)
    assert len(image.axes) == len(image.commands) == cables
    assert len(image.cells) == cables + 1
    seen = {image.checksum(0)}
    for table, name in ((image.axes, "angle"), (image.cells, "force")):
        for row in range(len(table)):
            table[name][row] = row + 0.5
            seen.add(image.checksum(0))
    image.tracker["delay"] = 0.25
    seen.add(image.checksum(0))
    assert len(seen) == 1 + cables + cables + 1 + 1


def packed(topic: Topic) -> bool:
    """Whether each member lies where CDR would align it, with no padding before or after."""
    fields, end = topic.dtype.fields or {}, 0
    for field in topic.fields:
        kind, offset = fields[field.name][:2]
        if offset != end or offset % field.width:
            return False
        end += kind.itemsize
    return end == topic.dtype.itemsize


@pytest.mark.parametrize("cables", ANY)
def test_the_record_has_a_value_for_each_cable_and_cell_and_is_a_cdr_body(cables: int) -> None:
    assert all(packed(topic) for topic in topics(cables))
    assert from_json(to_json(topics(cables))) == topics(cables)
    record = CycleRecord(cables)
    record.drives.angle[:] = np.arange(cables)
    record.force_cells.raw[:] = np.arange(cables + 1)
    assert record.data.dtype == cycle_dtype(cables)
    assert record.data["drives"]["angle"][0].tolist() == list(range(cables))
    assert record.data["force_cells"]["raw"][0].tolist() == list(range(cables + 1))


@pytest.mark.parametrize("cables", ANY)
def test_the_plants_state_begins_with_its_truth_and_is_aligned(cables: int) -> None:
    state, truth = state_dtype(cables), truth_dtype(cables)
    for name in truth.names or ():
        assert (state.fields or {})[name] == (truth.fields or {})[name]
    for record in (state, parameters_dtype(cables)):
        for kind, offset, *_ in (record.fields or {}).values():
            assert kind.base.itemsize == 1 or offset % 8 == 0


@settings(max_examples=80, deadline=None, derandomize=True)
@given(
    st.sampled_from(ANY),
    st.integers(0, 1000),
    st.tuples(*[st.floats(-500.0, 500.0)] * 3, *[st.floats(-50.0, 50.0)] * 3),
    st.data(),
)
def test_tensions_stay_in_their_bounds(
    cables: int, seed: int, wrench: tuple[float, ...], data: st.DataObject
) -> None:
    kinematics = Kinematics(geometry(cables, seed))
    kinematics.evaluate(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    there = np.array(data.draw(st.lists(st.booleans(), min_size=cables, max_size=cables)))
    low, high = np.where(there, TENSION.min, 0.0), np.where(there, TENSION.max, 0.0)
    distribution = TensionDistribution(CONFIG.control.distribution, LENGTH, cables)
    middle = np.where(there, TENSION.pre, 0.0)
    found = distribution(kinematics.matrix * there, np.array(wrench), middle, low, high)
    assert found.shape == (cables,)
    assert ((low <= found) & (found <= high)).all()


@pytest.mark.parametrize("cables", ANY)
def test_the_reserve_is_the_optimum_of_the_linear_programme(cables: int) -> None:
    at = poses(
        geometry(cables, 1), np.array([[0.0, 0.0, 0.0], [0.05, -0.1, 0.1]]), np.zeros((2, 3))
    )
    wrenches = np.array([[0.0, 0.0, 20.0, 0.0, 0.0, 0.0], [25.0, -5.0, 20.0, 1.0, 0.0, -1.0]])
    bounds = np.hstack([np.vstack([np.eye(cables), -np.eye(cables)]), np.ones((2 * cables, 1))])
    limits = np.repeat([TENSION.max, -TENSION.min], cables)
    found = reserves(at, wrenches, TENSION, LENGTH)
    for pose, matrix in enumerate(at.matrices):
        for number, wrench in enumerate(wrenches):
            best = linprog(
                np.append(np.zeros(cables), -1.0),
                A_ub=bounds,
                b_ub=limits,
                A_eq=np.hstack([matrix, np.zeros((6, 1))]),
                b_eq=wrench,
                bounds=(None, None),
            )
            assert found[pose, number] == pytest.approx(-best.fun, abs=1e-6)
