"""Whether this host computes fast enough for a lab in software beside the daemon."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from tonus.config.loader import load_scenario
from tonus.config.schema.root import Config
from tonus.tools.doctor.finding import Finding, Verdict, graded
from tonus.tools.run.composer import run
from tonus.tools.run.order import Order

_PLAYED_S = 0.5
"""in HOLD; the bring-up before it takes longer, and costs as much a second"""
_SEED = 1


def examine(config: Config, say: Callable[[str], None] = lambda _: None) -> list[Finding]:
    """Play a short run with everything recorded in virtual time, on one processor. Nothing for a
    robot, or a bus that has no real time."""
    if config.lab is None or any(bus.virtual_only for bus in config.fieldbus.parts):
        return []
    say("playing the lab in virtual time")
    scenario = load_scenario("hold").model_copy(update={"duration": _PLAYED_S})
    with TemporaryDirectory(prefix="tonus-doctor-") as folder:
        out = Path(folder) / "run"
        order = Order(config, scenario, out, _SEED, virtual=True, say=lambda _: None, live=False)
        factor = run(order).realtime_factor(config.control.rates.period)
    limits = config.realtime.host
    verdict = graded(factor, limits.lab_good_factor, limits.lab_bad_factor)
    remedy = "" if verdict is Verdict.GOOD else "tonus run --virtual, or --or-virtual"
    text = f"{factor:.1f} x real time in virtual time, on one processor"
    return [Finding("lab in software", text, verdict, remedy, {"factor": round(factor, 2)})]
