"""A controller outside the package, by its name: checked, run, recorded, replayed or refused."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from loop import QUICK

from tests.scripted import scripted
from tonus.config import ConfigError, load
from tonus.runtime.control.controllers import CONTROLLERS, controller_class, make_controller
from tonus.runtime.control.controllers.base import Controller
from tonus.runtime.control.controllers.linear import LinearLaw
from tonus.runtime.errors import ControllerError
from tonus.tools.check.controller import check_controller
from tonus.tools.check.controller_time import ROUNDS, TICKS, WARM_TICKS, controller_time
from tonus.tools.cli.main import main
from tonus.tools.log import open as open_log
from tonus.tools.margins.linearisation import linear_responses
from tonus.tools.margins.task import Loop, least_margins, margins
from tonus.tools.testing.player import Player

pytestmark = [
    pytest.mark.tonus(config="config/direct.yaml", overrides=QUICK),
    pytest.mark.wide,
]

MODULE = '''
import numpy as np
import tonus


class Soft(tonus.Controller):
    """Half of the base stiffness, at all times."""

    def stiffness(self, motion):
        return 0.5 * self.resting_stiffness


class Hard(Soft):
    def force(self, motion, stiffness):
        return 60.0 * super().force(motion, stiffness)


class Late(Soft):
    def __init__(self, robot, control):
        super().__init__(robot, control)
        self.past = [np.zeros(3)] * 60

    def force(self, motion, stiffness):
        self.past.append(super().force(motion, stiffness))
        return self.past.pop(0)


class Unit(Soft):
    def force(self, motion, stiffness):
        return motion.error / np.linalg.norm(motion.error)


class Root(Soft):
    def force(self, motion, stiffness):
        return super().force(motion, stiffness) + np.sqrt(min(0.0, motion.external[0]))


class Expires(Soft):
    ticks = 0

    def applied(self, tensions, active):
        self.ticks = self.ticks + 1 if active > 0.0 else 0

    def force(self, motion, stiffness):
        return super().force(motion, stiffness) * (np.nan if self.ticks > 1000 else 1.0)


class Short(Soft):
    def wrench(self, motion, stiffness):
        return np.zeros(3)


class Raises(Soft):
    def wrench(self, motion, stiffness):
        raise ValueError("no idea")


class Landing(Soft):
    def descent(self, motion):
        return np.zeros(6)


class Drummer(Soft):
    def force(self, motion, stiffness):
        return super().force(motion, stiffness) + 100.0 * motion.winding[:3]


class Shrinks(Soft):
    ticks = 0

    def applied(self, tensions, active):
        self.ticks = self.ticks + 1 if active > 0.0 else 0

    def wrench(self, motion, stiffness):
        return super().wrench(motion, stiffness)[: 3 if self.ticks > 1000 else 6]


class Turned(Soft):
    def force(self, motion, stiffness):
        return np.roll(super().force(motion, stiffness), 1)


class Lying(Hard):
    def linear_laws(self):
        return (self._spring(self.resting_stiffness),)


class Greedy(Soft):
    """Asks for all that there is, and more."""

    def stiffness(self, motion):
        return 1e9


class Abstract(tonus.Controller):
    pass


number = 3
'''
QUICK_RUN = " ".join(
    (
        "run config/direct.yaml --virtual --scenario hold --duration 0.3 --seed 1",
        *(f"--set {key}={value}" for key, value in QUICK.items()),
    )
)


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the module `of_mine`, on PYTHONPATH."""
    folder = tmp_path / "modules"
    folder.mkdir()
    (folder / "of_mine.py").write_text(MODULE)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(sys.modules, "of_mine", raising=False)
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(tmp_path / "runtime"))
    return folder


@pytest.fixture
def registered(mine: Path) -> str:
    """A distribution that registers `Soft` under a name of its own."""
    info = mine / "of_mine-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: of-mine\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[tonus.controllers]\nsoft_one = of_mine:Soft\n")
    return "soft_one"


def tonus(line: str, monkeypatch: pytest.MonkeyPatch) -> int:
    """The exit code of a command."""
    monkeypatch.setattr(sys, "argv", ["tonus", *line.split()])
    with pytest.raises(SystemExit) as ended:
        main()
    code = ended.value.code
    assert isinstance(code, int)
    return code


def found(name: str) -> dict[str, list[tuple[bool, str]]]:
    config, _ = load("config/direct.yaml", None, {"control.controller": f"of_mine:{name}"})
    rules: dict[str, list[tuple[bool, str]]] = {}
    for each in check_controller(config):
        rules.setdefault(each.rule, []).append((each.ok, each.text))
    return rules


def test_a_class_is_found_by_its_module(mine: Path) -> None:
    assert issubclass(controller_class("of_mine:Soft"), Controller)
    assert controller_class("bio") is CONTROLLERS["bio"]


def test_an_entry_point_is_found_by_its_name(registered: str) -> None:
    config, _ = load("config/direct.yaml", None, {"control.controller": registered})
    assert config.control.controller == registered
    assert type(make_controller(registered, config.robot, config.control)).__name__ == "Soft"


def test_two_entry_points_of_one_name_are_refused(registered: str, mine: Path) -> None:
    other = mine / "other-1.0.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1.0\n")
    (other / "entry_points.txt").write_text("[tonus.controllers]\nsoft_one = of_mine:Hard\n")
    with pytest.raises(ControllerError, match="as of_mine:Hard and as of_mine:Soft"):
        controller_class(registered)


def test_a_name_of_nothing_is_refused_where_it_stands() -> None:
    with pytest.raises(
        ConfigError, match=r"control.controller: .*package.module:Class.*'soft_one'"
    ):
        load("config/direct.yaml", None, {"control.controller": "soft_one"})


@pytest.mark.parametrize("name", ["bio", "pd", "pid", "bio_integral"])
def test_the_numeric_linearisation_is_what_our_own_controllers_state(name: str) -> None:
    """Against the laws that our controllers state, which are written separately."""
    config, _ = load("config/direct.yaml")
    law = make_controller(name, config.robot, config.control)
    stated = law.stated_laws()
    for response in linear_responses(config, name):
        each = min(stated, key=lambda one: abs(one.stiffness - response.stiffness))
        if each.stiffness != pytest.approx(response.stiffness):
            continue
        loops = [
            Loop(config, law.tension_loop, outer, response.axis, follows=True, response=own)
            for outer, own in ((each, None), (LinearLaw(), response))
        ]
        for cut in ("torque", "force"):
            theirs, ours = (least_margins([loop], cut) for loop in loops)
            assert ours.gain_db == pytest.approx(theirs.gain_db)
            assert ours.phase_deg == pytest.approx(theirs.phase_deg)
            assert ours.reduction_db == pytest.approx(theirs.reduction_db)


def test_its_margins_are_its_own(mine: Path) -> None:
    rules = found("Soft")
    assert all(ok for outcomes in rules.values() for ok, _ in outcomes)
    assert "Soft of of_mine" in rules["controller"][0][1]
    config, _ = load("config/direct.yaml")
    assert margins(config, "of_mine:Soft") != margins(config, "bio")


@pytest.mark.parametrize("name", ["Hard", "Late", "Lying"])
def test_an_unstable_one_is_refused(name: str, mine: Path) -> None:
    """By its gain, by a delay inside it, and whatever it says of itself."""
    outcomes = found(name)["margins"]
    assert [ok for ok, _ in outcomes] == [False, False]
    assert all("unstable" in text for _, text in outcomes)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Unit", "its wrench is not finite"),
        ("Root", "its wrench is not finite"),
        ("Short", "its wrench has the shape (3,), not (6,)"),
        ("Raises", "a tick raised ValueError: no idea"),
        ("Abstract", "cannot be made: TypeError"),
        ("Landing", "replaces descent, which a stop uses"),
        ("number", "number is not a subclass of tonus.Controller"),
        ("Missing", "cannot be imported: AttributeError"),
    ],
)
def test_one_that_cannot_be_used_is_refused(name: str, words: str, mine: Path) -> None:
    rules = found(name)
    ((ok, text),) = rules["controller"]
    assert not ok
    assert words in text
    assert "margins" not in rules


@pytest.mark.parametrize(
    ("name", "words"),
    [("Turned", "a force along another axis"), ("Drummer", "answers to cable lengths or rates")],
)
def test_one_with_another_loop_than_the_computed_one_has_no_margins(
    name: str, words: str, mine: Path
) -> None:
    ((ok, text),) = found(name)["margins"]
    assert not ok
    assert words in text


def test_one_that_is_too_slow_is_refused(mine: Path) -> None:
    """By a clock of ours: each reading is so much later than the last one."""
    config, _ = load("config/direct.yaml")
    limit = config.realtime.controller_share * config.control.rates.period_ns
    for step, ok in ((0.9 * limit, True), (1.1 * limit, False)):
        readings = iter(range(0, 10**12, int(step)))
        taken = controller_time(config, "of_mine:Soft", lambda: next(readings))  # noqa: B023
        assert taken.ok is ok
        assert taken.share == pytest.approx(step / config.control.rates.period_ns)


def test_a_host_that_disturbs_one_round_does_not_count(mine: Path) -> None:
    config, _ = load("config/direct.yaml")
    now, calls = 0, 0

    def clock() -> int:
        nonlocal now, calls
        calls += 1
        disturbed = calls < WARM_TICKS + 2 * TICKS * (ROUNDS - 1)
        now += 10_000_000 if disturbed else 1000
        return now

    assert controller_time(config, "of_mine:Soft", clock).ok


def test_it_runs_is_recorded_and_replayed(
    mine: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    assert tonus(f"{QUICK_RUN} --controller of_mine:Soft --out {out}", monkeypatch) == 0
    log = out / "run.mcap"
    capsys.readouterr()
    assert tonus(f"log info --json {log}", monkeypatch) == 0
    (told,) = json.loads(capsys.readouterr().out)
    assert told["metadata"]["controller"] == "of_mine:Soft"
    assert "controller: of_mine:Soft" in (open_log(log).config_text or "")
    law = open_log(log)["/tonus/stiffness"]["law"]
    base = load("config/direct.yaml")[0].control.stiffness.base
    assert law[-1] == 0.5 * base
    assert tonus(f"log replay {log}", monkeypatch) == 0
    assert "bit-equal" in capsys.readouterr().out
    monkeypatch.delitem(sys.modules, "of_mine")
    (mine / "of_mine.py").unlink()
    assert tonus(f"log replay {log}", monkeypatch) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert "run.mcap: controller of_mine:Soft: cannot be imported" in line


@pytest.mark.tonus_expect("stop_mode")
def test_one_that_is_not_installed_any_more_is_told_by_a_replay(
    registered: str,
    mine: Path,
    tonus_run: Player,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    early = scripted(operator=[{"at": 0.3, "command": "stop"}])
    log = tonus_run(early, controller=registered).log
    (mine / "of_mine-1.0.dist-info" / "entry_points.txt").write_text("")
    capsys.readouterr()
    assert tonus(f"log replay {log.path}", monkeypatch) == 2
    assert "its controller 'soft_one' is not installed here" in capsys.readouterr().err


@pytest.mark.tonus_expect("*")
def test_limits_and_limiter_apply_to_it(mine: Path, tonus_run: Player) -> None:
    run = tonus_run("hold", controller="of_mine:Greedy", duration=0.1)
    assert run.state == "STANDBY", run.reason
    log, (config, _) = run.log, load("config/direct.yaml")
    law, tension = config.control.stiffness, config.control.tension
    k_eq = log["/tonus/stiffness"]["k_eq"]
    assert log["/tonus/stiffness"]["law"].max() == 1e9
    assert k_eq.max() <= law.maximum
    risen = np.diff(k_eq)[k_eq[:-1] > 0.0]  # it is 0 before the limiter is asked
    assert 0.0 < risen.max() <= law.rise_rate * config.control.rates.period * (1.0 + 1e-9)
    assert log["/tonus/tension"]["reference"].max() <= tension.max * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ("name", "fault"), [("Expires", "not_finite"), ("Shrinks", "control_failed")]
)
def test_one_that_goes_wrong_in_a_run_ends_in_a_passive_stop(
    name: str,
    fault: str,
    mine: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = tmp_path / "out"
    run = f"{QUICK_RUN} --duration 1.2 --controller of_mine:{name} --out {out}"
    assert tonus(run, monkeypatch) == 1
    summary = json.loads((out / "summary.json").read_text())
    assert summary["faults"][0]["name"] == fault
    assert np.isfinite(open_log(out / "run.mcap")["/tonus/drives"]["torque_command"]).all()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("--controller of_mine:Hard", "unstable: a pole of the closed loop"),
        ("--controller of_mine:Unit", "not finite"),
        ("--controller not_there:Any", "cannot be imported: ModuleNotFoundError"),
        ("--controller of_mine:number", "not a subclass"),
        ("--controller of_mine:Raises --force", "ValueError: no idea"),
        ("--controller of_mine:Short --force", "could not broadcast"),
        ("--controller not_there:Any --force", "cannot be imported"),
    ],
)
def test_a_run_refuses_in_one_line(
    line: str,
    words: str,
    mine: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert tonus(f"{QUICK_RUN} {line} --out {tmp_path / 'out'}", monkeypatch) == 2
    (told,) = capsys.readouterr().err.strip().splitlines()
    assert words in told


def test_check_takes_it_from_the_command_line(
    mine: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its time on this host is measured here as well, and judged in another test."""
    line = "check config/direct.yaml --controller of_mine:Hard"
    assert tonus(f"{line} --set realtime.controller_share=0.99 --json", monkeypatch) == 1
    rules = json.loads(capsys.readouterr().out)
    assert {each["rule"] for each in rules} >= {"controller", "margins", "time"}
    assert [each["ok"] for each in rules if each["rule"] == "margins"] == [False, False]


def test_time_is_a_matter_of_real_time_only(
    mine: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """With a share of the period that no controller can keep."""
    out = tmp_path / "out"
    mean = f"--controller of_mine:Soft --set realtime.controller_share=1e-9 --out {out}"
    assert tonus(f"run config/can.yaml --scenario hold {mean}", monkeypatch) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "of the period of 1000 us on this host" in line
    assert not out.exists()
    assert tonus(f"{QUICK_RUN} --duration 0.1 {mean}", monkeypatch) == 0
