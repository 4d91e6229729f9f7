"""A made-up run with known figures, recorded through the rings like a real one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tonus.config.schema.control import Recording
from tonus.runtime.recording.recorder import Recorder
from tonus.runtime.recording.ring import RingWriter
from tonus.runtime.recording.taps import EventRing, FrameRing, Level
from tonus.runtime.recording.viewer import Scene
from tonus.runtime.signals import cycle_dtype, topics
from tonus.runtime.states import Fault, State
from tonus.runtime.topics import Field, Topic, to_json
from tonus.sim.lab.truth import truth_dtype, truth_fields

TRUTH, TRUTH_FIELDS = truth_dtype(8), truth_fields(8)

CYCLE, TOPICS = cycle_dtype(8), topics(8)

MS = 1_000_000
CHANNELS = ("can0", "can1")
FRAMES_PER_TICK = 4
TRACKING_ERROR = np.array([0.3e-3, 0.4e-3, 0.0])  # m, RMSE 0.5 mm
TENSION_ERROR = 0.2  # N
PHASES = (
    (State.OFF, 0.02),
    (State.STANDBY, 0.05),
    (State.REFERENCING, 0.1),
    (State.PRETENSION, 0.15),
    (State.HOLD, 0.2),
    (State.ACTIVE, 0.9),
    (State.SAFE_STOP, 0.95),
    (State.FAULT, 1.0),
)


def recording(**options: object) -> Recording:
    given = {"ring_s": 8.0, "chunk_ms": 250, "compression": "zstd", "raw_frames": True}
    return Recording.model_validate({**given, **options})


def truth_topic() -> Topic:
    fields = tuple(Field(*field) for field in TRUTH_FIELDS)
    return Topic("/tonus/truth", "tonus_msgs/msg/Truth", "what is really so", fields)


def cycles(count: int, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    rows = np.zeros(count, CYCLE)
    share = np.arange(count) / count
    state = np.full(count, int(State.FAULT))
    for phase, until in reversed(PHASES):
        state[share < until] = phase
    rows["timing"]["tick"] = np.arange(count)
    rows["timing"]["due_ns"] = np.arange(count) * MS
    rows["timing"]["wakeup_us"] = np.arange(count) % 100
    rows["timing"]["compute_us"] = 200.0
    rows["timing"]["missed_own"] = share > 0.5
    rows["timing"]["missed_host"] = 3 * (share > 0.6)
    rows["state"]["state"] = state
    rows["state"]["fault"] = np.where(state >= State.SAFE_STOP, Fault.CONTACT_LIMIT, 0)
    rows["state"]["fault_where"] = np.where(state >= State.SAFE_STOP, 8, -1)
    load = 100.0 * np.clip((share - 0.3) / 0.3, 0, 1) * (share < 0.8)
    rows["wrench"]["external"][:, 0] = load + rng.normal(0, 0.5, count)
    rows["wrench"]["contact"] = 5 * np.sin(9 * share) ** 2
    rows["stiffness"]["law"] = 3210 + 8 * load
    rows["stiffness"]["k_eq"] = np.clip(rows["stiffness"]["law"], 420, 4879.2)
    rows["stiffness"]["cap"] = 4879.2
    rows["tension"]["reference"] = 45 + 0.5 * load[:, None] * np.linspace(-0.4, 1, 8)
    rows["tension"]["measured"] = rows["tension"]["reference"]
    rows["pose"]["desired_position"][:, 0] = 0.03 * np.sin(20 * share)
    return rows


def truth(rows: np.ndarray) -> np.ndarray:
    result = np.zeros(len(rows), TRUTH)
    result["position"] = rows["pose"]["desired_position"] + TRACKING_ERROR
    result["tension"] = rows["tension"]["reference"] + TENSION_ERROR
    result["load"][:, 0] = 100.0 * np.clip((np.arange(len(rows)) / len(rows) - 0.3) / 0.3, 0, 1)
    result["contact_force"] = rows["wrench"]["contact"]
    return result


class Rings:
    """The four rings of a run in ``folder``."""

    def __init__(self, folder: Path, capacity: int = 8000) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        meta = {"kind": "record", "topics": to_json(TOPICS)}
        self.cycle = RingWriter.create(folder / "cycle.ring", CYCLE.itemsize, capacity, meta)
        meta = {"kind": "record", "topics": to_json([truth_topic()])}
        self.truth = RingWriter.create(folder / "truth.ring", TRUTH.itemsize, capacity, meta)
        self.frames = FrameRing.open(folder / "frames.ring", CHANNELS, capacity * FRAMES_PER_TICK)
        self.events = EventRing.open(folder / "events.ring")

    def tick(self, k: int, rows: np.ndarray, true: np.ndarray) -> None:
        self.truth.publish(true[k : k + 1], k * MS)
        for n in range(FRAMES_PER_TICK):
            data = (1000 * k + n).to_bytes(8, "little")[: 8 - n]
            self.frames.frame(k * MS + n * 1000, n % 2, 0x181 + n, data, sent=n == 0)
        self.cycle.publish(rows[k : k + 1], k * MS)
        if k and rows["state"]["state"][k] != rows["state"]["state"][k - 1]:
            name = State(int(rows["state"]["state"][k])).name
            self.events.write(k * MS, k, Level.INFO, "STATE", "cycle", f"entered {name}, wär’s so")


def record(
    folder: Path,
    count: int = 1200,
    *,
    seed: int = 1,
    drain_every: int = 50,
    rows: np.ndarray | None = None,
    metadata: dict[str, str] | None = None,
    scene: Scene | None = None,
    **options: object,
) -> Path:
    """Record ``count`` ticks, or these ``rows``, into ``folder``/run.mcap."""
    rings = Rings(folder / "rings")
    rows = cycles(count, seed) if rows is None else rows
    true = truth(rows)
    recorder = Recorder(
        folder / "rings",
        folder / "run.mcap",
        recording(**options),
        {"seed": str(seed), "scenario": "synthetic", **(metadata or {})},
        {"config.yaml": b"name: synthetic\n"},
        0,
        scene=scene,
    )
    for k in range(count):
        rings.tick(k, rows, true)
        if k % drain_every == drain_every - 1:
            recorder.drain()
    recorder.finish()
    return recorder.path
