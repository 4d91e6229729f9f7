"""The emulated tracker: its datagram, its rate, its latency, its noise."""

from __future__ import annotations

import struct
from types import SimpleNamespace

import numpy as np
import pytest
from plant_setup import CONFIG, LAB

from tonus.config import load
from tonus.config.schema.lab import LabScript, Occlusion, TrackerShift
from tonus.sim.devices.tracker import Tracker
from tonus.sim.lab.engine import Lab

NOISE = LAB.noise.tracker
POSE = {"position": np.array([0.0123, -0.05, 0.2]), "quaternion": np.array([0.5, 0.5, -0.5, 0.5])}


def tracker(seed: int = 1, **noise: object) -> Tracker:
    seen = SimpleNamespace(now_ns=1_000, **POSE)
    return Tracker(CONFIG.tracker, NOISE.model_copy(update=noise), seen, seed)


def watched(t: Tracker, exposures: int) -> list[tuple[object, ...]]:
    datagrams = []
    for _ in range(exposures):
        t.expose(t.next_ns)
        datagrams += t.poll(t.next_ns)
    datagrams += t.poll(t.next_ns + 1_000_000_000)
    assert all(len(d) == 84 for d in datagrams)
    return [struct.unpack("<4sHHIIq3d4df", d) for d in datagrams]


def test_the_datagram() -> None:
    quiet = tracker(position_sigma=0.0, rotation_sigma=0.0, jitter_ms=0.0)
    magic, version, body, sequence, flags, stamp, *pose, residual = watched(quiet, 1)[0]
    assert (magic, version, body, sequence, flags, stamp) == (b"TNTK", 1, 0, 0, 1, 1_000)
    assert pose == pytest.approx([0.0123, -0.05, 0.2, 0.5, 0.5, -0.5, 0.5])
    assert residual == 0.0


def test_rate_and_order_over_a_long_time() -> None:
    poses = watched(tracker(), 1201)
    stamps = [p[5] for p in poses]
    assert stamps[-1] == 1_000 + round(1200 * 1e9 / CONFIG.tracker.rate_hz)
    assert [p[3] for p in poses] == list(range(1201))


def test_latency_and_jitter() -> None:
    t = tracker()
    late = []
    for _ in range(500):
        at = t.next_ns
        t.expose(at)
        arrival = t.next_arrival_ns
        assert arrival is not None
        assert t.poll(arrival - 1) == []
        assert len(t.poll(arrival)) == 1
        assert t.poll(arrival) == []
        late.append((arrival - at) * 1e-6)
    low, high = (
        CONFIG.tracker.latency_ms - NOISE.jitter_ms,
        CONFIG.tracker.latency_ms + NOISE.jitter_ms,
    )
    assert low <= min(late) < low + 0.1
    assert high - 0.1 < max(late) <= high


def test_a_robots_own_seed_draws_its_constant_errors_and_not_its_noise() -> None:
    seen = SimpleNamespace(now_ns=1_000, **POSE)
    still = {"position_sigma": 0.0, "rotation_sigma": 0.0, "position_grid": 0.0}
    noise = {"latency_ms": (4.0, 10.0), "position_bias_sigma": 0.01, "jitter_ms": 0.0}

    def first(seed: int, own: int | None, **also: float) -> tuple[object, ...]:
        t = Tracker(CONFIG.tracker, NOISE.model_copy(update=noise | also), seen, seed, own)
        t.expose(t.next_ns)
        arrival = t.next_arrival_ns
        assert arrival is not None
        return arrival, t.poll(arrival)[0]

    assert first(1, 7, **still) == first(2, 7, **still) == first(7, None, **still)
    assert first(1, 7, **still)[0] != first(1, 8, **still)[0]
    assert first(1, 7)[1] != first(2, 7)[1]


def test_the_lab_draws_the_trackers_errors_with_its_robots_seed() -> None:
    noise = {"lab.robot_seed": 7, "lab.noise.tracker.latency_ms": [4.0, 10.0]}
    config, _ = load("config/direct.yaml", overrides=noise)
    labs = [Lab(config, LabScript(), seed=seed, clock=lambda: 0) for seed in (1, 2)]
    first, second = (lab._tracker._latency_ns for lab in labs)
    assert first == second


def test_noise_and_grid() -> None:
    poses = watched(tracker(), 2000)
    positions = np.array([p[6:9] for p in poses])
    steps = positions / NOISE.position_grid
    assert steps == pytest.approx(np.round(steps), abs=1e-6)
    spread = np.sqrt(NOISE.position_sigma**2 + NOISE.position_grid**2 / 12)
    assert np.std(positions, axis=0) == pytest.approx([spread] * 3, rel=0.3)
    assert np.mean(positions, axis=0) == pytest.approx(POSE["position"], abs=3e-5)
    quaternions = np.array([p[9:13] for p in poses])
    assert np.linalg.norm(quaternions, axis=1) == pytest.approx(1.0)
    angles = 2 * np.arccos(np.clip(np.abs(quaternions @ POSE["quaternion"]), -1, 1))
    assert np.sqrt(np.mean(angles**2) / 3) == pytest.approx(NOISE.rotation_sigma, rel=0.1)


def test_a_blocked_tracker_says_so_and_its_noise_goes_on_alike() -> None:
    seen, hidden = tracker(), tracker()
    for t in (seen, hidden):
        t.blocked = t is hidden
        for _ in range(10):
            t.expose(t.next_ns)
        t.blocked = False
    a, b = watched(seen, 5), watched(hidden, 5)
    assert [p[4] for p in b] == [0] * 10 + [1] * 5
    assert a[10:] == b[10:]


def test_a_script_hides_the_platform_and_shifts_its_pose_for_a_while() -> None:
    t = tracker(position_sigma=0.0, rotation_sigma=0.0, position_grid=0.0)
    turn = (0.0, 0.0, 0.02)
    shift = TrackerShift(at=0.5, duration=0.25, position=(0.0, 0.003, 0.0), rotation=turn)
    t.start_script(1_000, [Occlusion(at=0.1, duration=0.2)], [shift])
    poses = watched(t, 121)
    times = (np.array([p[5] for p in poses]) - 1_000) * 1e-9
    hidden = np.array([p[4] == 0 for p in poses])
    assert np.array_equal(hidden, (times >= 0.1) & (times < 0.3))
    off = np.array([p[6:9] for p in poses])[~hidden] - POSE["position"]
    shifted = ((times >= 0.5) & (times < 0.75))[~hidden]
    assert off[shifted] == pytest.approx(np.tile([0.0, 0.003, 0.0], (int(np.sum(shifted)), 1)))
    assert off[~shifted] == pytest.approx(0.0, abs=1e-12)
    quaternions = np.array([p[9:13] for p in poses])[~hidden]
    angles = 2 * np.arccos(np.clip(np.abs(quaternions @ POSE["quaternion"]), -1, 1))
    assert angles == pytest.approx(np.where(shifted, 0.02, 0.0), abs=1e-6)


def test_drop_outs_begin_at_random_and_last_as_long_as_configured() -> None:
    single = np.array([p[4] == 0 for p in watched(tracker(dropout_probability=0.05), 4000)])
    assert np.mean(single) == pytest.approx(0.05, rel=0.2)
    long = watched(tracker(dropout_probability=0.01, dropout_ms=40.0), 4000)
    lost = np.array([p[4] == 0 for p in long]).astype(int)
    begins, ends = np.flatnonzero(np.diff(lost) > 0), np.flatnonzero(np.diff(lost) < 0)
    lengths = ends[: len(begins)] - begins[: len(ends)]
    assert len(lengths) > 20
    assert min(lengths) == 5  # exposures of 8.3 ms in 40 ms, the first included
    seen = watched(tracker(), 4000)
    assert all(a == b for a, b in zip(seen, long, strict=True) if b[4])


def test_what_is_wrong_with_a_tracker_is_drawn_once_per_seed() -> None:
    quiet = {"position_sigma": 0.0, "rotation_sigma": 0.0, "position_grid": 0.0, "jitter_ms": 0.0}
    biases, latencies = [], []
    for seed in range(200):
        t = tracker(seed, position_bias_sigma=1e-3, latency_ms=(4.0, 10.0), **quiet)
        at = t.next_ns
        t.expose(at)
        assert t.next_arrival_ns is not None
        latencies.append((t.next_arrival_ns - at) * 1e-6)
        first, second = (np.array(p[6:9]) for p in watched(t, 1))
        assert np.array_equal(first, second)
        biases.append(first - POSE["position"])
    assert np.std(biases) == pytest.approx(1e-3, rel=0.1)
    assert 4.0 <= min(latencies) < 4.3
    assert 9.7 < max(latencies) <= 10.0


def test_seeds() -> None:
    assert watched(tracker(1), 50) == watched(tracker(1), 50)
    assert watched(tracker(1), 50) != watched(tracker(2), 50)
