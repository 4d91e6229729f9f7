"""Tables, verdicts and the page of a made-up campaign whose answers are known."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paper_setup import CONTROLLERS, FACTOR, SEEDS, campaign
from rich.console import Console

from tonus.tools.errors import ToolError
from tonus.tools.paper import printed
from tonus.tools.paper.claims import claims
from tonus.tools.paper.compare import compared, matches
from tonus.tools.paper.publish import publish
from tonus.tools.paper.results import Results, Row
from tonus.tools.paper.table import Column, Spread, Table, number, text
from tonus.tools.paper.tables import by_case, can_sample, plants, table2, table3
from tonus.tools.paper.targets import targets
from tonus.tools.paper.verdicts import Claim, Verdict, gain, limit, match

R, C, N, M = Verdict.REPRODUCED, Verdict.CONSISTENT, Verdict.NOT_REPRODUCED, Verdict.MISSING


def judged(results: Results) -> dict[str, Claim]:
    return {claim.name: claim for claim in claims(results, matches(results))}


def changed(results: Results, **indicators: float) -> Results:
    """Every row that has them, with other indicators."""
    rows = [
        replace(
            row,
            indicators={
                **row.indicators,
                **{name: value for name, value in indicators.items() if name in row.indicators},
            },
        )
        for row in results
    ]
    return Results(rows, results.traces)


@pytest.mark.parametrize(
    ("values", "bound", "expected"),
    [([1.0, 2.0], 2.0, R), ([1.0, 2.5], 2.0, C), ([2.0, 3.0], 2.0, N), ([], 2.0, M)],
)
def test_a_limit_holds_for_all_for_the_mean_or_not(
    values: list[float], bound: float, expected: Verdict
) -> None:
    assert limit(Spread.of(values), bound).verdict is expected
    mirrored = limit(Spread.of([-v for v in values]), -bound, least=True)
    assert mirrored.verdict is expected


@pytest.mark.parametrize(("value", "expected"), [(109.0, R), (80.0, C), (60.0, N)])
def test_a_match_is_near_or_not(value: float, expected: Verdict) -> None:
    assert match(Spread.of([value]), 100.0).verdict is expected


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([40.0, 41.0], R),
        ([20.0, 22.0], C),
        ([10.0, 12.0], N),
        ([90.0, -1.0], N),
        ([-5.0, -6.0], N),
        ([60.0], C),
        ([], M),
    ],
)
def test_a_gain_must_hold_with_every_seed(values: list[float], expected: Verdict) -> None:
    assert gain(Spread.of(values), 38.2).verdict is expected


def test_a_ceiling_lowers_and_never_raises() -> None:
    good, bad = limit(Spread.of([1.0]), 2.0), limit(Spread.of([3.0]), 2.0)
    assert good.at_most(C, "why").verdict is C
    assert bad.at_most(C, "why").verdict is N
    assert limit(None, 1.0).at_most(C, "why").verdict is M


def test_comparison_pairs_seeds_and_keeps_to_common_cases() -> None:
    found = compared(campaign(), printed.SETTLING)
    assert set(found.values) == set(CONTROLLERS)
    assert found.improvements("bio") == pytest.approx([10.0] * len(SEEDS))
    assert found.improvements("pd") == pytest.approx([-20.0] * len(SEEDS))
    assert (found.standing("bio"), found.standing("pd")) == ("better", "worse")
    assert found.best() == "bio_observer"


def test_more_is_better_for_efficiency() -> None:
    found = compared(campaign(), printed.EFFICIENCY)
    assert found.improvements("bio_observer") == pytest.approx([100.0] * len(SEEDS))
    assert found.best() == "bio_observer"


def test_what_no_instrument_could_tell_apart_is_no_gain() -> None:
    found = compared(changed(campaign(), overshoot_percent=0.01), printed.OVERSHOOT)
    found.values["pid"] = dict.fromkeys(SEEDS, 0.001)
    assert found.improvements("bio") == [0.0] * len(SEEDS)
    assert found.standing("bio") == "even"


def test_a_case_that_one_controller_lacks_counts_for_none() -> None:
    whole = campaign()
    rows = [
        row
        for row in whole
        if not (row.case == "sine_x_10mm_1Hz" and row.controller == "pid" and row.plant == "lab")
    ]
    tracking = printed.OURS[0]
    assert len(compared(whole, tracking).cases) == 2
    assert compared(Results(rows), tracking).cases == ("sine_z_30mm_0.5Hz",)


def test_a_faulted_trial_counts_for_safety_only() -> None:
    rows = [
        replace(row, fault="slack") if row.case == "press" and row.seed == 2 else row
        for row in campaign()
    ]
    found = compared(Results(rows), printed.FORCE)
    assert sorted(found.values["bio"]) == [1, 3]
    row = Row("k", 3, "c", "contact", "bio", "lab", 1, "direct", {"contact_peak": 30.0}, fault="f")
    assert row.get("contact_peak") == 30.0
    assert replace(row, indicators={"position_rmse": 1.0}).get("position_rmse") is None


def test_table_3_holds_the_papers_numbers_and_ours() -> None:
    table, data = table3(campaign())
    first = data["rows"][0]
    assert first["paper"] == {"pid": 6.8, "bio": 4.2, "improvement_percent": 38.2}
    assert first["controllers"]["bio"]["improvement_percent"]["mean"] == pytest.approx(10.0)
    assert first["controllers"]["bio"]["n"] == len(SEEDS)
    assert first["best"] == "bio_observer"
    assert data["standing_against_reference"]["bio_observer"] == dict.fromkeys(
        ("RMSE_F", "T_s", "M_p", "E_d", "η", "E_keq"), "better"
    )
    assert [column.name for column in table.columns[4:6]] == ["pid", "bio"]


def test_the_papers_own_improvements_follow_from_its_columns() -> None:
    for indicator, pid, bio, gain_percent in printed.TABLE3:
        sign = 1.0 if indicator.more_is_better else -1.0
        assert sign * 100.0 * (bio - pid) / pid == pytest.approx(gain_percent, abs=0.06)


def test_table_2_compares_the_model_with_the_lab() -> None:
    whole = campaign()
    _, data = table2(whole, matches(whole))
    rows = {row["symbol"]: row for row in data["rows"]}
    mean = np.mean([1.0 + 0.01 * seed for seed in SEEDS])
    assert rows["T_s"]["model"] == pytest.approx(0.6 * FACTOR["bio"])
    assert rows["T_s"]["lab"]["mean"] == pytest.approx(0.6 * FACTOR["bio"] * mean)
    assert rows["T_s"]["difference_percent"] == pytest.approx(100.0 * (1.0 / mean - 1.0))
    assert rows["φ"]["cases"] == ["sine_z_30mm_0.5Hz"]
    assert 0.9 < rows["R²"]["response"]["min"] < 1.0


def test_r_squared_falls_when_the_lab_departs_from_the_model() -> None:
    whole = campaign()

    def off(key: str) -> Any:
        found = whole.traces(key)
        if found is not None and ".lab." in key and "ramp" in key:
            found["position"] = -found["position"]
        return found

    other = Results(whole.rows, off)
    assert judged(whole)["r2"].verdict is R
    worst = min(matches(other), key=lambda found: found.r2)
    assert worst.case == "ramp_x"
    assert judged(other)["r2"].verdict in (C, N)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("tracking", R),
        ("force", R),
        ("load", N),
        ("settling", R),
        ("attenuation", C),
        ("slope", C),
        ("range", C),
        ("reaction", R),
        ("tension", R),
        ("eq9", N),
        ("contact", R),
        ("envelope", R),
        ("better_contact_force_rmse", N),
        ("better_efficiency_percent", N),
        ("better_tension_spread", R),
        ("efficiency_value", N),
        ("eq13", N),
        ("stable", R),
    ],
)
def test_verdicts_of_the_made_up_campaign(name: str, expected: Verdict) -> None:
    assert judged(campaign())[name].verdict is expected


@pytest.mark.parametrize(
    ("name", "indicator", "value", "expected"),
    [
        ("tracking", "position_rmse", 0.003, N),
        ("slope", "slope", 300.0, N),
        ("reaction", "reaction", 0.2, N),
        ("eq13", "eq13_broken_percent", 0.0, R),
        ("contact", "contact_peak", 26.0, N),
        ("envelope", "violation_ticks", 5.0, N),
        ("range", "k_eq_outside_ticks", 1.0, N),
        ("better_settling", "settling", 0.5, N),
        ("load", "load_deviation_peak", 0.002, R),
    ],
)
def test_verdicts_follow_the_data(
    name: str, indicator: str, value: float, expected: Verdict
) -> None:
    assert judged(changed(campaign(), **{indicator: value}))[name].verdict is expected


def test_a_reference_that_never_settles_is_no_missing_data() -> None:
    rows = []
    for row in campaign():
        if row.controller == "pid" and "settling" in row.indicators:
            rest = {name: v for name, v in row.indicators.items() if name != "settling"}
            row = replace(row, indicators={**rest, "unsettled": 1.0})  # noqa: PLW2901
        rows.append(row)
    claim = judged(Results(rows))["better_settling"]
    assert (claim.verdict, claim.unit) == (C, "s")
    assert "in each of its" in claim.sentence


def test_the_contact_claim_needs_an_envelope_that_was_needed() -> None:
    rows = [row for row in campaign() if row.key != "open"]
    assert judged(Results(rows))["contact"].verdict is C


def test_every_claim_without_data_says_so() -> None:
    for claim in claims(Results([]), []):
        assert claim.verdict is M
        assert claim.sentence == "No trial of this run bears on it."


def test_targets_show_the_worst_of_each_controller() -> None:
    _, found = targets(campaign())
    by_name = {entry["target"]: entry for entry in found}
    tracking = by_name["tracking, worst sine"]
    assert tracking["values"]["bio"] == pytest.approx(0.1 * 0.9 * 1.03)
    assert tracking["met"] == {"bio": True, "bio_observer": True, "pid": True}
    assert by_name["drawn plants"]["values"]["bio"] == 200
    assert by_name["drawn plants: error, median"]["met"]["bio"]
    _, worse = targets(changed(campaign(), position_rmse=0.002))
    assert not worse[0]["met"]["bio"]


def test_drawn_plants_are_counted_and_ranked() -> None:
    _, found = plants(campaign())
    assert found["bio"]["plants"] == 200
    assert found["bio"]["position_rmse_mm"]["median"] == pytest.approx(0.2 + 0.005 * 99.5)
    assert found["bio"]["faults"] == 0


@pytest.mark.parametrize(("factor", "agree"), [(1.0, True), (1.04, True), (1.3, False)])
def test_the_sample_on_can_must_agree_with_the_direct_bus(factor: float, agree: bool) -> None:
    whole = campaign()
    rows = [
        replace(
            row,
            bus="can",
            indicators={
                **row.indicators,
                "position_rmse": factor * row.indicators["position_rmse"],
            },
        )
        for row in whole.select(case="sine_z_30mm_0.5Hz", controller="bio", seed=2)
    ]
    _, found = can_sample(Results([*whole.rows, *rows]))
    assert found["agree"] is agree


def test_rows_survive_their_file() -> None:
    for row in campaign():
        assert Row.from_json(json.loads(json.dumps(row.as_json()))) == row


def test_a_table_three_ways() -> None:
    table = Table(
        "t",
        "A <title>",
        (Column("name"), Column("figure", "mm")),
        [["a & b", Spread(1.25, 0.04, 1.2, 1.3, 3)], ["c", None]],
    )
    table.marked.add((0, 1))
    lines = list(csv.reader(io.StringIO(table.csv())))
    assert lines[0] == ["name", "figure / mm", "figure / mm, SD", "figure, n"]
    assert lines[1] == ["a & b", "1.25", "0.04", "3"]
    assert lines[2] == ["c", "", "", ""]
    assert "a &amp; b" in table.html()
    assert "A &lt;title&gt;" in table.html()
    console = Console(width=100, file=io.StringIO())
    console.print(table)
    assert "1.25 ± 0.04" in console.file.getvalue()  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.0, "0"),
        (1234.5, "1234"),
        (0.012345, "0.0123"),
        (-0.0000001, "-0.000000100"),
        (9.999, "10.00"),
    ],
)
def test_numbers_are_printed_without_an_exponent(value: float, shown: str) -> None:
    assert number(value) == shown


def test_a_deviation_is_never_rounded_away() -> None:
    assert text(Spread(12.0, 0.12, 11.9, 12.1, 5), 2) == "12.0 ± 0.1"
    assert text(Spread(12.0, 0.0, 12.0, 12.0, 5), 2) == "12 ± 0"
    assert text(None) == "–"


def numbers(value: Any) -> list[float]:
    if isinstance(value, dict):
        return [found for entry in value.values() for found in numbers(entry)]
    if isinstance(value, list):
        return [found for entry in value for found in numbers(entry)]
    return [value] if isinstance(value, float) else []


@pytest.mark.wide
def test_publish_writes_everything_and_the_page_stands_alone(tmp_path: Path) -> None:
    said: list[Any] = []
    whole = publish(campaign(), tmp_path, said.append)
    assert {"stage1", "stage2", "stage3", "table2", "table3", "claims"} <= whole.keys()
    assert json.loads((tmp_path / "paper.json").read_text()) == whole
    assert all(math.isfinite(value) for value in numbers(whole))
    assert said
    page = (tmp_path / "paper.html").read_text()
    assert page.index("Verdicts</h2>") < page.index("Tables</h2>") < page.index("Figures</h2>")
    assert not re.findall(r'(?:src|href)="(?!data:|#)', page)
    assert not re.findall(r"https?://(?!www\.w3\.org)", page)
    names = {"table2", "table3", "stage1", "stage2", "stage3", "claims", "improvement", "targets"}
    assert names <= {file.stem for file in (tmp_path / "tables").iterdir()}
    drawn = {file.stem for file in (tmp_path / "figures").glob("*.svg")}
    assert len(drawn) == 11


@pytest.mark.parametrize("kept", ["nothing", "a sine", "faults"])
def test_publish_works_on_part_of_a_campaign(kept: str, tmp_path: Path) -> None:
    rows = {
        "nothing": [],
        "a sine": [row for row in campaign() if row.kind == "sine" and row.controller == "pd"],
        "faults": [replace(row, fault="slack", indicators={}) for row in campaign()],
    }[kept]
    whole = publish(Results(rows), tmp_path)
    assert len(whole["claims"]) > 20
    assert (tmp_path / "paper.html").exists()
    if kept == "faults":
        assert whole["stage3"][0]["failed"]


def test_a_place_that_cannot_be_written_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ToolError, match="choose another with --out"):
        publish(Results([]), tmp_path / "file")


def test_by_case_keeps_what_broke_down() -> None:
    rows = [row for row in campaign() if row.controller == "eq9_literal"]
    found = by_case(Results(rows))[0]
    assert found["trials"] == 1
    assert found["failed"][0]["fault"] == "slack"
