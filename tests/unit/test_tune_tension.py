"""`tonus tune tension` designs a loop that keeps its floors, for the robot's own period."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner, Result
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tonus.config import load
from tonus.config.loader import load_tuning
from tonus.tools.check import rules
from tonus.tools.cli.tune import tune
from tonus.tools.errors import ToolError
from tonus.tools.margins.tension_loop import tension_errors
from tonus.tools.start_configuration import write_configuration
from tonus.tools.tune.tension import design

pytestmark = pytest.mark.wide

CONFIG, _ = load("config/can.yaml")
TICKS = 60
FEW = ("--evaluations", "160")


def integrated(friction: float, reference: float) -> NDArray[np.float64]:
    """The error (ticks,) in N of the shipped loop on one drum, by integrating its equations."""
    train, loop = CONFIG.robot.drive_trains[0], CONFIG.control.tension_loop
    period, length = CONFIG.control.rates.period, 1.1
    drum, cable, radius = train.drum, train.cable, train.drum.radius
    bandwidths = CONFIG.response
    stiffness = cable.axial_stiffness / length
    drive, cell = (2.0 * np.pi * f for f in (bandwidths.current_loop_hz, bandwidths.force_cell_hz))

    def pull(state: NDArray[np.float64]) -> float:
        return float(radius * (stiffness * state[0] + cable.damping * state[1]))

    def motion(_: float, state: NDArray[np.float64], command: float) -> list[float]:
        torque = state[2] - radius * (pull(state) + friction)
        acceleration = (torque - drum.viscous_friction * state[1]) / drum.inertia
        return [
            state[1],
            acceleration,
            drive * (command - state[2]),
            cell * (pull(state) - state[3]),
        ]

    state, commands, errors = np.zeros(4), [0.0, 0.0], []
    integral = slope = last = before = 0.0
    for _ in range(TICKS):
        errors.append(reference - pull(state))
        error = reference - state[3]
        integral += loop.integral * period * error
        share = 1.0 - np.exp(-2.0 * np.pi * loop.lead_cutoff_hz * period)
        slope += share * (reference - last - slope)
        rate = (state[0] - before) / period
        wanted = loop.lead * slope / (stiffness * radius * period)
        tension = loop.feed_forward * reference + loop.proportional * error + integral
        commands.append(radius * tension + loop.rate_damping * (wanted - rate))
        last, before = reference, state[0]
        solved = solve_ivp(
            motion, (0.0, period), state, args=(commands[-3],), rtol=1e-9, atol=1e-12
        )
        state = solved.y[:, -1]
    return np.array(errors)


def test_the_error_that_is_minimised_is_that_of_the_equations() -> None:
    found = tension_errors(
        CONFIG.robot.drive_trains[0],
        CONFIG.control.tension_loop,
        CONFIG.control.rates.period,
        cable_length=1.1,
        current_loop_hz=CONFIG.response.current_loop_hz,
        cell_bandwidth_hz=CONFIG.response.force_cell_hz,
        ticks=TICKS,
    )
    np.testing.assert_allclose(found[:, 0], integrated(1.0, 0.0), atol=1e-6)
    np.testing.assert_allclose(found[:, 1], integrated(0.0, 1.0), atol=1e-6)


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result, dict[str, object]]:
    """A new configuration at 500 Hz, where no shipped gain is stable enough, after the design."""
    folder = tmp_path_factory.mktemp("slow") / "mine"
    write_configuration(folder, "config/can.yaml")
    control = folder / "control.yaml"
    control.write_text(control.read_text().replace("period_us: 1000", "period_us: 2000"))
    failed = [each.rule for each in rules.check(*load(str(folder / "robot.yaml"))) if not each.ok]
    assert failed == ["tension loop", "margins", "margins"]
    out = folder / "tension.yaml"
    options = ["--config", str(folder / "robot.yaml"), "--out", str(out), "--land", *FEW]
    result = CliRunner().invoke(tune, ["tension", *options])
    return folder, result, yaml.safe_load(out.read_text())


def test_every_floor_is_kept_at_500_hz_where_no_shipped_gain_keeps_any(
    slow: tuple[Path, Result, dict[str, object]],
) -> None:
    folder, result, written = slow
    assert result.exit_code == 0, result.output
    assert "changed" in result.output
    findings = rules.check(*load(str(folder / "robot.yaml")))
    assert [each.text for each in findings if not each.ok] == []
    loop = load(str(folder / "robot.yaml"))[0].control.tension_loop
    after = written["after"]
    assert isinstance(after, dict)
    assert after["gains"] == {key: getattr(loop, key) for key in after["gains"]}


def test_the_result_says_what_was_reached_from_where(
    slow: tuple[Path, Result, dict[str, object]],
) -> None:
    _, result, written = slow
    table = result.output
    assert re.search(r"proportional\s.* 20 ", table)
    assert re.search(r"tension loop by itself\s.*0\.8 dB, 5\.2 deg", table)
    assert written["period_us"] == 2000
    assert written["floors"] == {"gain_db": 6.0, "phase_deg": 35.0}


def test_the_same_seed_gives_the_same_gains() -> None:
    settings = load_tuning().tension_loop.model_copy(update={"evaluations": 40})
    first, second = (design(CONFIG, settings, lambda done, best: None) for _ in range(2))
    assert first.evaluations == 40
    assert first.after == second.after


def test_what_cannot_keep_the_floors_does_not_land(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    write_configuration(folder, "config/can.yaml")
    control = folder / "control.yaml"
    control.write_text(
        control.read_text().replace("phase_margin_deg: 35.0", "phase_margin_deg: 120.0")
    )
    before = control.read_text()
    options = ["--config", str(folder / "robot.yaml"), "--out", str(tmp_path / "out.yaml")]
    result = CliRunner().invoke(tune, ["tension", *options, "--land", "--json", *FEW[:1], "40"])
    assert result.exit_code == 1
    assert "no gains keep the floors of the tension loop by itself" in result.stderr
    assert json.loads(result.stdout)["after"]["gains"]
    assert control.read_text() == before


def test_an_option_that_means_nothing_here_is_refused() -> None:
    result = CliRunner().invoke(tune, ["tension", "--jobs", "2"])
    assert isinstance(result.exception, ToolError)
    assert "--jobs: the tension loop is designed in one process" in str(result.exception)
