"""The pages docs/fmea.md, docs/hazards.md and docs/requirements.md, printed from docs/safety."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from tonus.tools.safety.budget import shown
from tonus.tools.safety.schema import Failure, Tests
from tonus.tools.safety.source import Evidence

_SOURCE = """\
This page is printed from the files in `docs/safety/` (`python -m tonus.tools.safety {page}`);
[the rules for a change](code.md#the-safety-evidence) say how to add a line. Tonus claims
conformity with no standard ([intended use](intended_use.md)).
"""
_FMEA = """\
# Failure modes

For those who judge the safety concept: every single failure of every part with its effect, its
detection, its reaction and the time of it, the risk that remains and the test that shows it.

{source}
Times are those of the shipped configuration with its lab (1 ms ticks), computed from the keys
named beside them; on a robot they are shorter ([below](#lost-frames)). "stop" is the controlled
stop of [states.md](states.md), "stop without the cable" the descent with the remaining cables
([stop.md](stop.md)). Situations are those of [hazards.md](hazards.md).
[fault_pairs.md](fault_pairs.md) has pairs of failures.

A simulated envelope on a desktop system is not a safety function. Nothing here replaces an
emergency stop that disconnects the drives' power (STO).

{count} failures; {open}.
"""
_LOST = """\
## Lost frames

No lost frame by itself stops the robot. Timeouts follow from the periods and from `tolerance`
in the configuration (losses in a row by kind, at least one, and the jitter); `tonus check` and
`tonus run` refuse a configuration that states shorter ones.

- Drives wait for the daemon's heartbeat (0x1016), sent each 20 ms, (lost + 1) periods and the
  jitter: 100 ms with the lab, 60 ms on a robot. For this time they act on the last torque when
  the daemon has ended.
- The daemon waits for a node's heartbeat, sent each 100 ms, by the same rule: 260 ms and 220
  ms.
- EtherCAT slaves wait for outputs, sent each tick, by the same rule: 62 ms and 22 ms.
- A measurement is usable for 3 ticks; the check requires at least the tolerated losses plus
  `late_ticks`. A device without one stops the robot after 25 ticks with the lab, after 5 (6 ms
  in place of 26 ms) on a robot.
- A pose is usable for 100 ms; the check requires at least (lost + 1) periods, its latency and
  the jitter.
"""
_HAZARDS = """\
# Hazards

For those who judge the safety concept: the hazards of the moving robot that software acts on, the
situations in which they do harm, the controls, and the risk that remains.

{source}
Tonus is a part of a machine. The builder of the machine analyses the whole machine, with the
hazards that no software acts on (electric shock, sharp edges, a frame that falls over, a
cable's end that whips), and decides what has to be a safety function.
"""
_REQUIREMENTS = """\
# Requirements of the safety path

For those who judge or change the safety path: what each control demands of the software, and the
tests that show it.

{source}
In these files every test belongs to a requirement; one that belongs to none fails `make test`:
{files}.
"""


def fmea(evidence: Evidence) -> str:
    """docs/fmea.md."""
    rows = list(evidence.rows)
    left = [row.id for row in rows if row.open is not None]
    told = f"{len(left)} of them open, without a test ({', '.join(left)})" if left else "none open"
    parts = [_FMEA.format(source=_SOURCE.format(page="fmea"), count=len(rows), open=told)]
    for part, failures in evidence.failures.items():
        parts += [f"## {part}\n", _table(_FAILURE_HEAD, (_failure(row) for row in failures))]
    return "\n".join([*parts, _LOST])


_FAILURE_HEAD = (
    "id",
    "failure",
    "effect",
    "noticed by",
    "done",
    "state",
    "within",
    "leads to",
    "requirements",
    "remaining risk",
    "shown by",
)


def _failure(row: Failure) -> Sequence[str]:
    return (
        row.id,
        row.failure,
        row.effect,
        row.noticed,
        row.reaction,
        row.state,
        shown(row.within) if row.within is not None else row.when or "",
        ", ".join(row.leads_to),
        ", ".join(row.requirements),
        row.residual,
        _tests(row.tests) if row.open is None else f"**open**: {row.open}",
    )


def hazards(evidence: Evidence) -> str:
    """docs/hazards.md."""
    rows = {
        name: [row.id for row in evidence.rows if name in row.leads_to]
        for name in evidence.situations
    }
    by_control = {
        name: [key for key, hazard in evidence.hazards.items() if name in hazard.controls]
        for name in evidence.controls
    }
    return "\n".join(
        [
            _HAZARDS.format(source=_SOURCE.format(page="hazards")),
            "## Hazards and remaining risk\n",
            _table(
                ("id", "hazard", "harm", "controls", "remaining risk"),
                (
                    (name, each.hazard, each.harm, ", ".join(each.controls), each.residual)
                    for name, each in evidence.hazards.items()
                ),
            ),
            "## Hazardous situations\n",
            _table(
                ("id", "of", "situation", "failures that lead to it ([fmea.md](fmea.md))"),
                (
                    (situation, name, text, ", ".join(rows[situation]))
                    for name, each in evidence.hazards.items()
                    for situation, text in each.situations.items()
                ),
            ),
            "## Controls\n",
            _table(
                (
                    "id",
                    "control",
                    "kind",
                    "of",
                    "requirements ([requirements.md](requirements.md))",
                ),
                (
                    (
                        name,
                        each.control,
                        each.kind,
                        ", ".join(by_control[name]),
                        ", ".join(each.requirements),
                    )
                    for name, each in evidence.controls.items()
                ),
            ),
        ]
    )


def requirements(evidence: Evidence) -> str:
    """docs/requirements.md."""
    files = ", ".join(f"`{name}`" for name in sorted(evidence.safety_path))
    named = {
        name: [key for key, control in evidence.controls.items() if name in control.requirements]
        for name in evidence.requirements
    }
    return "\n".join(
        [
            _REQUIREMENTS.format(source=_SOURCE.format(page="requirements"), files=files),
            "## Requirements and tests\n",
            _table(
                ("id", "requirement", "control", "shown by"),
                (
                    (name, each.text, ", ".join(named[name]), _tests(each.tests))
                    for name, each in evidence.requirements.items()
                ),
            ),
        ]
    )


def _tests(tests: Tests) -> str:
    return ", ".join(f"{file}::{name}" for file, names in tests.items() for name in names)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    lines += [f"| {' | '.join(cells)} |" for cells in rows]
    return "\n".join(lines) + "\n"
