"""Tables 2 and 3 with the paper's columns beside ours, and a table for each stage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tonus.tools.paper.compare import BIO, REFERENCE, Compared, Match, compared, of, usual
from tonus.tools.paper.printed import OURS, TABLE2, TABLE2_R2, TABLE3
from tonus.tools.paper.results import Results, Row
from tonus.tools.paper.table import Cell, Column, Spread, Table

Json = dict[str, Any]
_STAGE1 = (
    ("slope", "slope", "N/m", 1.0, 4),
    ("slope_loading", "loading", "N/m", 1.0, 4),
    ("slope_unloading", "unloading", "N/m", 1.0, 4),
    ("slope_phantom", "phantom alone", "N/m", 1.0, 4),
    ("slope_fit", "line's R²", "", 1.0, 4),
    ("travel", "way", "mm", 1e3, 3),
)
_STAGE2 = (
    ("position_rmse", "error, RMS", "mm", 1e3, 2),
    ("phase_lag_deg", "phase", "°", 1.0, 2),
    ("amplitude_error_percent", "amplitude", "%", 1.0, 2),
    ("settling", "T_s", "s", 1.0, 3),
    ("overshoot_percent", "M_p", "%", 1.0, 2),
    ("tension_rmse", "tension, RMS", "N", 1.0, 2),
    ("force_rmse", "force, RMS", "N", 1.0, 2),
    ("moment_rmse", "moment, RMS", "N m", 1.0, 2),
)
_STAGE3 = (
    ("load_deviation_peak", "deviation, peak", "mm", 1e3, 3),
    ("load_deviation_end", "at the end", "mm", 1e3, 2),
    ("load_settling", "T_s", "s", 1.0, 3),
    ("reaction", "K_eq, 63 %", "ms", 1e3, 3),
    ("k_eq_at_end", "K_eq, end", "N/m", 1.0, 4),
    ("contact_peak", "contact, peak", "N", 1.0, 3),
    ("contact_force_rmse", "contact, RMS error", "N", 1.0, 2),
    ("tension_rmse", "tension, RMS", "N", 1.0, 2),
)
_CAN = (
    ("position_rmse", "error, RMS", "mm", 1e3),
    ("tension_rmse", "tension, RMS", "N", 1.0),
    ("contact_force_rmse", "contact, RMS error", "N", 1.0),
    ("load_deviation_peak", "load deviation, peak", "mm", 1e3),
    ("contact_peak", "contact, peak", "N", 1.0),
    ("settling", "settling", "s", 1.0),
)
CAN_NOISE = 3.0
"""standard deviations over seeds within which CAN and direct agree, or"""
CAN_SHARE = 0.05
"""this share of the figure, whichever is more"""


def by_case(results: Results) -> list[Json]:
    """Every case of every controller on every plant and bus: how many trials, which broke down,
    and every indicator over its seeds. For paper.json."""
    groups: dict[tuple[str, str, str, str], list[Row]] = {}
    for row in results:
        groups.setdefault((row.case, row.controller, row.plant, row.bus), []).append(row)
    found = []
    for (case, controller, plant, bus), rows in groups.items():
        chosen = Results(rows)
        names = dict.fromkeys(name for row in rows for name in row.indicators)
        spreads = {name: Spread.of(chosen.values(name)) for name in names}
        found.append(
            {
                "case": case,
                "kind": rows[0].kind,
                "controller": controller,
                "plant": plant,
                "bus": bus,
                "trials": len(rows),
                "failed": [_failure(row) for row in rows if not row.completed],
                "indicators": {
                    name: spread.as_json() for name, spread in spreads.items() if spread
                },
            }
        )
    return found


def _failure(row: Row) -> Json:
    return {"key": row.key, "seed": row.seed, "fault": row.fault, "reason": row.reason}


def stage1(results: Results) -> Table:
    """The slope of force against way, eq. (8)."""
    rows = results.select(stage=1, plant=None, bus=None)
    table = _stage(
        rows,
        _STAGE1,
        "stage1",
        "Stage 1: slope of force against way at constant tension, eq. (8)",
        with_plant=True,
    )
    table.notes.append("paper: 420 N/m. model: without friction, noise or a wrong constant")
    return table


def stage2(results: Results) -> Table:
    """Sines and minimum-jerk steps in the lab."""
    return _stage(
        results.select(stage=2), _STAGE2, "stage2", "Stage 2: sines and steps, lab, against truth"
    )


def stage3(results: Results) -> Table:
    """Loads and contact in the lab."""
    return _stage(
        results.select(stage=3), _STAGE3, "stage3", "Stage 3: loads and contact, lab, against truth"
    )


def _stage(
    results: Results,
    shown: Sequence[tuple[str, str, str, float, int]],
    name: str,
    title: str,
    *,
    with_plant: bool = False,
) -> Table:
    kept = [column for column in shown if len(results.values(column[0]))]
    columns = [Column("case"), Column("controller"), *([Column("plant")] if with_plant else [])]
    columns += [Column(label, unit, digits) for _, label, unit, _, digits in kept]
    table = Table(name, title, tuple(columns), lead=3 if with_plant else 2)
    cases: dict[tuple[str, str, str], list[Row]] = {}
    for row in results:
        cases.setdefault((row.case, row.controller, row.plant), []).append(row)
    broken = 0
    for (case, controller, plant), rows in cases.items():
        bad = sum(not row.completed for row in rows)
        broken += bad
        own = [f"{controller} ({bad} of {len(rows)} failed)" if bad else controller]
        cells: list[Cell] = [case, *own, *([plant] if with_plant else [])]
        for key, _, _, scale, _ in kept:
            spread = Spread.of(Results(rows).values(key))
            # Where there is nothing to touch, a peak of zero says nothing.
            idle = key == "contact_peak" and spread is not None and spread.high == 0.0
            cells.append(spread.times(scale) if spread and not idle else None)
        table.rows.append(cells)
    if broken:
        table.notes.append(f"ended in a fault: {broken}; of these only what tells of safety")
    return table


def table2(results: Results, match: list[Match], controller: str = BIO) -> tuple[Table, Json]:
    """Simulated and experimental become model and lab."""
    table = Table(
        "table2",
        f"Table 2: the paper's simulation and experiment; our model and lab ({controller})",
        (
            Column("parameter"),
            Column("symbol"),
            Column("unit"),
            Column("paper, simulated", digits=0),
            Column("paper, experiment", digits=0),
            Column("model"),
            Column("lab"),
            Column("model - lab", "% of lab", 2),
        ),
        lead=3,
    )
    rows: list[Json] = []
    for indicator, simulated, experiment, printed in TABLE2:
        chosen = _phase_cases(results) if indicator.key == "phase_lag_deg" else results
        model = compared(chosen, indicator, plant="model")
        lab = compared(chosen, indicator)
        told, real = model.spread(controller), lab.spread(controller)
        off = None
        if told is not None and real is not None and real.mean != 0.0:
            off = 100.0 * (told.mean - real.mean) / real.mean
        table.rows.append(
            [
                *(indicator.label, indicator.symbol, indicator.unit, simulated, experiment),
                None if told is None else told.mean,
                *(real, off),
            ]
        )
        rows.append(
            {
                "parameter": indicator.label,
                "symbol": indicator.symbol,
                "unit": indicator.unit,
                "indicator": indicator.key,
                "cases": list(lab.cases),
                "paper": {
                    "simulated": simulated,
                    "experimental": experiment,
                    "relative_error_percent": printed,
                },
                "model": None if told is None else told.mean,
                "lab": None if real is None else real.as_json(),
                "difference_percent": off,
            }
        )
    response = [found.r2 for found in match]
    table.rows.append(
        [
            *("Coefficient of determination", "R²", "–", *TABLE2_R2, None),
            float(np.mean(response)) if response else None,
            None,
        ]
    )
    if match:
        worst = min(match, key=lambda found: found.r2)
        slack = min(match, key=lambda found: found.force_r2)
        table.notes.append(
            f"R²: lab against model, mean of {len(match)} cases; least {worst.r2:.4f}, "
            f"{worst.case}. Of the cables' resultant, which slow motion hardly moves: "
            f"{slack.force_r2:.2f} at least, {slack.case}"
        )
    table.notes.append("phase: sines at 0.5 Hz where there are any; all accuracy against truth")
    rows.append(
        {
            "parameter": "Coefficient of determination",
            "symbol": "R²",
            "paper": {"simulated": TABLE2_R2[0], "experimental": TABLE2_R2[1]},
            "response": _summary(response),
            "force": _summary([found.force_r2 for found in match]),
            "cases": [
                {
                    "case": found.case,
                    "r2": found.r2,
                    "force_r2": found.force_r2,
                    "force_difference_percent": found.force_percent,
                }
                for found in match
            ],
        }
    )
    return table, {"controller": controller, "rows": rows}


def _phase_cases(results: Results) -> Results:
    """The sines at 0.5 Hz, or all where there is none."""
    chosen = [row for row in results if row.indicators.get("frequency_hz") == 0.5]
    return Results(chosen, results.traces, results.untuned) if chosen else results


def _summary(values: list[float]) -> Json | None:
    spread = Spread.of(values)
    return None if spread is None else spread.as_json()


def controllers_of(results: Results) -> list[str]:
    """Those that Table 3 compares: the paper's two first, then the rest as they come."""
    names = usual(results).select().names("controller")
    shown = [name for name in (REFERENCE, BIO) if name in names]
    compared_on = {row.controller for item in TABLE3 for row in of(results, item[0])}
    return shown + [name for name in names if name not in shown and name in compared_on]


def table3(results: Results) -> tuple[Table, Json]:
    """The paper's PID and bio-inspired columns beside all our controllers."""
    names = controllers_of(results)
    table = Table(
        "table3",
        "Table 3: the paper's PID and bio-inspired control; ours, "
        f"{'NOT tuned alike' if results.untuned else 'tuned alike'}, lab",
        (
            Column("indicator"),
            Column("unit"),
            Column("paper, PID", digits=0),
            Column("paper, bio", digits=0),
            *(Column(name) for name in names),
        ),
        lead=2,
    )
    rows: list[Json] = []
    below: dict[str, float] = {}
    standing: dict[str, dict[str, str]] = {name: {} for name in names}
    for indicator, pid, bio, gain in TABLE3:
        found = compared(results, indicator)
        _add(table, found, names, (pid, bio))
        for name in names:
            if (place := found.standing(name)) and name != REFERENCE:
                standing[name][indicator.symbol] = place
        spread = found.spread(BIO)
        if spread is not None and spread.sd_percent is not None:
            below[indicator.symbol] = spread.sd_percent
        rows.append(_json_row(found, names, {"pid": pid, "bio": bio, "improvement_percent": gain}))
    for indicator in OURS:
        found = compared(results, indicator)
        if found.values:
            _add(table, found, names, (None, None))
            rows.append(_json_row(found, names, None))
    table.notes.append("bold: best. ±: standard deviation over the seeds' means")
    failed = sum(not row.completed for row in usual(results).select())
    if failed:
        table.notes.append(f"ended in a fault and not in the means: {failed}")
    if below:
        worst = max(below, key=lambda symbol: below[symbol])
        table.notes.append(
            f"paper: SD below 5 %. Ours for {BIO}: {worst} {below[worst]:.1f} % at most"
        )
    return table, {
        "reference": REFERENCE,
        "controllers": names,
        "rows": rows,
        "standing_against_reference": {name: places for name, places in standing.items() if places},
        "sd_percent": below,
    }


def _add(
    table: Table, found: Compared, names: list[str], printed: tuple[float | None, float | None]
) -> None:
    indicator, best = found.indicator, found.best()
    shown: list[Cell] = [found.spread(name) for name in names]
    label = f"{indicator.label} {indicator.symbol}"
    table.rows.append([label, indicator.unit, *printed, *shown])
    means = {spread.mean for spread in shown if isinstance(spread, Spread)}
    # K_eq is neither good nor bad.
    if best in names and len(means) > 1 and indicator.key != "k_eq_mean":
        table.marked.add((len(table.rows) - 1, names.index(best) + 4))


def _json_row(found: Compared, names: list[str], printed: Json | None) -> Json:
    indicator = found.indicator
    columns: Json = {}
    for name in names:
        spread = found.spread(name)
        if spread is None:
            continue
        gains = Spread.of(found.improvements(name))
        columns[name] = {
            **spread.as_json(),
            "sd_percent": spread.sd_percent,
            "improvement_percent": None if gains is None else gains.as_json(),
            "standing": found.standing(name) if name != REFERENCE else None,
        }
    return {
        "indicator": indicator.label,
        "symbol": indicator.symbol,
        "unit": indicator.unit,
        "key": indicator.key,
        "cases": list(found.cases),
        "paper": printed,
        "controllers": columns,
        "best": found.best(),
    }


def improvements(results: Results) -> Table:
    """Table 3's last column: how much better than PID, in %."""
    names = [name for name in controllers_of(results) if name != REFERENCE]
    table = Table(
        "improvement",
        f"Improvement on {'an untuned' if results.untuned else 'the tuned'} PID, %: "
        "positive is better (paired by seed)",
        (
            Column("indicator"),
            Column("paper, bio", digits=0),
            *(Column(name, "", 2) for name in names),
        ),
    )
    better = dict.fromkeys(names, 0)
    for indicator, _, _, gain in TABLE3:
        found = compared(results, indicator)
        cells: list[Cell] = [f"{indicator.label} {indicator.symbol}", gain]
        for place, name in enumerate(names):
            cells.append(Spread.of(found.improvements(name)))
            if found.standing(name) == "better":
                better[name] += 1
                table.marked.add((len(table.rows), place + 2))
        table.rows.append(cells)
    table.rows.append(["better with every seed", 6, *(better[name] for name in names)])
    return table


def plants(results: Results) -> tuple[Table, Json]:
    """The drawn plants: how many, how accurate, and what went wrong."""
    rows = results.select(plant="plants", bus=None)
    table = Table(
        "plants",
        "Drawn plants: EA, anchors, mass, friction and tracker latency wrong at random",
        (
            Column("controller"),
            Column("plants"),
            Column("error, median", "mm"),
            Column("90 %", "mm"),
            Column("worst", "mm"),
            Column("faults"),
            Column("with slack"),
            Column("longest violation", "ticks"),
        ),
    )
    found: Json = {}
    for name in rows.names("controller"):
        own = rows.select(controller=name, plant=None, bus=None)
        error = own.values("position_rmse") * 1e3
        faults = sum(not row.completed for row in own)
        slack = int((own.values("slack_ticks") > 0).sum())
        violations = own.values("violation_longest")
        longest = int(violations.max()) if len(violations) else None
        quantiles = [float(q) for q in np.percentile(error, (50, 90, 100))] if len(error) else []
        shown: list[Cell] = [*quantiles] if quantiles else [None, None, None]
        table.rows.append([name, len(own.rows), *shown, faults, slack, longest])
        found[name] = {
            "plants": len(own.rows),
            "position_rmse_mm": None
            if not quantiles
            else dict(zip(("median", "p90", "max"), quantiles, strict=True)),
            "faults": faults,
            "with_slack": slack,
            "longest_violation_ticks": longest,
        }
    return table, found


def can_sample(results: Results) -> tuple[Table, Json]:
    """What was repeated on CAN frames, beside the same trials without frames."""
    table = Table(
        "can",
        "Repeated on CAN frames, beside the same seeds without frames",
        (
            Column("case"),
            Column("controller"),
            Column("indicator"),
            Column("unit"),
            Column("direct"),
            Column("CAN"),
            Column("agree"),
        ),
    )
    found: list[Json] = []
    can = results.select(bus="can", plant=None)
    for case in can.names("case"):
        here = can.select(case=case, bus=None, plant=None)
        for controller in here.names("controller"):
            framed = here.select(controller=controller, bus=None, plant=None)
            plant = framed.rows[0].plant
            direct = results.select(case=case, controller=controller, plant=plant)
            for key, label, unit, scale in _CAN:
                there, own = Spread.of(framed.values(key)), Spread.of(direct.values(key))
                if there is None or own is None or own.mean == 0.0:
                    continue
                room = max(CAN_NOISE * (own.sd or 0.0), CAN_SHARE * abs(own.mean))
                agree = abs(there.mean - own.mean) <= room
                table.rows.append(
                    [
                        *(case, controller, label, unit),
                        *(own.times(scale), there.times(scale), "yes" if agree else "NO"),
                    ]
                )
                found.append(
                    {
                        "case": case,
                        "controller": controller,
                        "indicator": key,
                        "direct": own.as_json(),
                        "can": there.as_json(),
                        "agree": agree,
                    }
                )
    table.notes.append(
        f"agree: means within {CAN_NOISE:g} standard deviations over seeds, or {CAN_SHARE:.0%}"
    )
    agreed = all(entry["agree"] for entry in found) if found else None
    return table, {"agree": agreed, "rows": found}
