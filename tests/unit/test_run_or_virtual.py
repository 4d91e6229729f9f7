"""`tonus run --or-virtual`: a run that delays disturbed is played again, and nothing is lost."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from tonus.config import load
from tonus.tools.cli.run import _disturbed, run
from tonus.tools.run.composer import Order


@pytest.mark.parametrize(
    ("first", "arguments", "played", "exit_code"),
    [
        ((False, True), ["--or-virtual"], [False, True], 0),
        ((False, True), [], [False], 1),
        ((False, False), ["--or-virtual"], [False], 1),
        ((True, False), ["--or-virtual"], [False], 0),
    ],
    ids=["disturbed", "not asked for", "a fault of its own", "undisturbed"],
)
def test_only_a_disturbed_run_is_played_again_and_beside_the_first(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    first: tuple[bool, bool],
    arguments: list[str],
    played: list[bool],
    exit_code: int,
) -> None:
    orders: list[Order] = []

    def play(order: Order, *, as_json: bool) -> tuple[bool, bool]:
        assert not as_json
        orders.append(order)
        return (True, False) if order.virtual else first

    monkeypatch.setattr("tonus.tools.cli.run._play", play)
    result = CliRunner().invoke(run, ["config/can.yaml", "--out", str(tmp_path), *arguments])
    assert result.exit_code == exit_code, result.output
    assert [order.virtual for order in orders] == played
    assert [order.out for order in orders] == [tmp_path, tmp_path / "virtual"][: len(played)]


@pytest.mark.parametrize("other", ["--json", "--serve"])
def test_it_is_for_a_person_with_a_scenario(other: str) -> None:
    result = CliRunner().invoke(run, ["config/can.yaml", "--or-virtual", other])
    assert result.exit_code == 2
    assert "leave --serve or --json out" in result.output


@pytest.mark.parametrize(
    ("own", "host", "steal_percent", "disturbed"),
    [
        (0, 1, 0.0, True),
        (1, 0, 0.0, True),
        (0, 0, 1.0, True),
        (0, 0, 0.9, False),
        (0, 0, None, False),
    ],
)
def test_a_disturbance_is_any_tick_missed_or_time_taken_from_the_lab_alone(
    own: int, host: int, steal_percent: float | None, disturbed: bool
) -> None:
    """A host may be too slow as well as away."""
    config, _ = load("config/can.yaml")
    assert config.realtime.host.steal_bad_percent == 1.0
    summary = {"missed_ticks": own, "missed_by_host": host, "steal_percent": steal_percent}
    assert _disturbed(config, summary) is disturbed
