"""`tonus log figure`: every figure is drawn, from the log's numbers, alone and of several runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib import image
from synthetic_run import TENSION_ERROR, TRACKING_ERROR, cycles, record

from tonus.runtime.states import State
from tonus.tools.cli.log import log as command
from tonus.tools.errors import ToolError
from tonus.tools.log import open as open_log
from tonus.tools.report.plots import PLOTS, draw
from tonus.tools.report.story import Story

TICKS = 3000
OF_ONE = {"position", "envelope", "spectra"}
SIGNATURES = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two runs; the second begins its ACTIVE later, and is stiffer."""
    made = []
    for name, late in (("soft", 0), ("stiff", 90)):
        rows = cycles(TICKS)
        state = rows["state"]["state"]
        rows["state"]["state"] = np.roll(state, late)
        rows["state"]["state"][:late] = int(State.OFF)
        rows["stiffness"]["k_eq"] += 10.0 * late
        rows["pose"]["position"] = rows["pose"]["desired_position"]
        folder = tmp_path_factory.mktemp("runs") / name
        metadata = {"controller": "bio" if late else "pid"}
        made.append(record(folder, TICKS, rows=rows, metadata=metadata, raw_frames=False))
    return made


def drawn(what: str, *paths: Path):
    return draw([open_log(path) for path in paths], what)


def curves(figure, panel: int = 0) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    return {
        str(line.get_label()): (np.asarray(line.get_xdata()), np.asarray(line.get_ydata()))
        for line in figure.axes[panel].get_lines()
        if not str(line.get_label()).startswith("_")
    }


@pytest.mark.parametrize("what", [*PLOTS])
def test_every_figure_of_one_run_is_drawn(paths: list[Path], tmp_path: Path, what: str) -> None:
    out = tmp_path / "x.png"
    told = CliRunner().invoke(command, ["figure", str(paths[0]), "--what", what, "--out", str(out)])
    assert told.exit_code == 0, told.output
    assert told.output.strip() == str(out)
    pixels = image.imread(out)[..., :3]
    assert pixels.shape[0] > 400
    assert (pixels < 0.95).any(axis=2).mean() > 0.005


@pytest.mark.parametrize("what", [name for name, plot in PLOTS.items() if plot.several])
def test_every_figure_of_several_runs_names_each(paths: list[Path], what: str) -> None:
    figure = drawn(what, *paths)
    for axes in figure.axes:
        texts = " ".join(text.get_text() for text in axes.get_legend().get_texts())
        assert "soft (pid)" in texts
        assert "stiff (bio)" in texts


def test_what_shows_one_run_only_refuses_two(paths: list[Path]) -> None:
    assert {name for name, plot in PLOTS.items() if plot.several is None} == OF_ONE
    for what in OF_ONE:
        with pytest.raises(ToolError, match="shows one log, and 2 are named"):
            drawn(what, *paths)


def test_tensions_are_the_true_ones_and_less_their_reference(paths: list[Path]) -> None:
    figure = drawn("tension", paths[0])
    rows = open_log(paths[0])["/tonus/tension"]["reference"]
    _, values = curves(figure)["cable 7"]
    assert values.max() == pytest.approx(rows[:, 7].max() + TENSION_ERROR)
    _, errors = curves(figure, 1)["cable 2"]
    assert errors[~np.isnan(errors)] == pytest.approx(TENSION_ERROR)


def test_runs_are_aligned_at_start(paths: list[Path]) -> None:
    figure = drawn("error", *paths)
    assert figure.axes[0].get_xlabel() == "time since START / s"
    found = curves(figure)
    for name, path in (("soft (pid), truth", paths[0]), ("stiff (bio), truth", paths[1])):
        time, values = found[name]
        story = Story(open_log(path))
        start = story.time[int(story.in_state(State.ACTIVE).argmax())]
        assert time[0] == pytest.approx(-start)
        known = values[~np.isnan(values)]
        assert known == pytest.approx(1e3 * np.linalg.norm(TRACKING_ERROR))


def test_runs_without_a_start_are_drawn_from_the_first_cycle(
    paths: list[Path], tmp_path: Path
) -> None:
    rows = cycles(600)
    rows["state"]["state"] = int(State.HOLD)
    other = record(tmp_path, 600, rows=rows, raw_frames=False)
    figure = drawn("stiffness", paths[0], other)
    assert figure.axes[0].get_xlabel() == "time since the first message / s"
    assert [time[0] for time, _ in curves(figure).values()] == [0.0, 0.0]


def test_a_path_is_in_millimetres_and_its_axes_are_alike(paths: list[Path]) -> None:
    (axes,) = drawn("path", paths[0]).axes
    lines = {str(line.get_label()): line.get_data_3d() for line in axes.get_lines()}
    story = Story(open_log(paths[0]))
    active = story.in_state(State.ACTIVE)
    desired = 1e3 * open_log(paths[0])["/tonus/pose"]["desired_position"][active]
    assert len(lines["desired"][0]) == active.sum()
    assert np.allclose(np.transpose(lines["desired"]), desired)
    gone = desired + 1e3 * TRACKING_ERROR
    assert np.allclose(np.transpose(lines["true"]), gone)
    spans = [np.ptp(limits) for limits in (axes.get_xlim(), axes.get_ylim(), axes.get_zlim())]
    assert spans == pytest.approx([spans[0]] * 3)
    assert axes.get_xlim()[0] < desired[:, 0].min() < desired[:, 0].max() < axes.get_xlim()[1]


@pytest.mark.parametrize("kind", [*SIGNATURES])
def test_the_name_s_ending_is_the_format_and_the_bytes_are_the_same_again(
    paths: list[Path], tmp_path: Path, kind: str
) -> None:
    files = [tmp_path / f"{number}.{kind}" for number in range(2)]
    for file in files:
        told = CliRunner().invoke(
            command, ["figure", str(paths[0]), "--what", "stiffness", "--out", str(file)]
        )
        assert told.exit_code == 0, told.output
    assert files[0].read_bytes().startswith(SIGNATURES[kind])
    assert files[0].read_bytes() == files[1].read_bytes()


def test_the_default_name_stands_beside_the_log(paths: list[Path]) -> None:
    told = CliRunner().invoke(command, ["figure", str(paths[1]), "--what", "speed"])
    assert told.exit_code == 0, told.output
    assert (paths[1].parent / "run.speed.png").is_file()


def test_the_list_names_every_figure() -> None:
    told = CliRunner().invoke(command, ["figure", "--list"])
    assert told.exit_code == 0
    lines = [line.split() for line in told.output.splitlines()]
    assert [words[0] for words in lines] == [*PLOTS]
    assert {words[0] for words in lines if words[-3:] == ["of", "one", "run"]} == OF_ONE


def test_a_damaged_log_is_drawn_up_to_the_damage(paths: list[Path], tmp_path: Path) -> None:
    cut = tmp_path / "run.mcap"
    data = paths[0].read_bytes()
    cut.write_bytes(data[: len(data) * 6 // 10])
    told = CliRunner().invoke(command, ["figure", str(cut), "--what", "force"])
    assert told.exit_code == 1, told.output
    assert "used up to there" in told.output
    assert (tmp_path / "run.force.png").is_file()


def virtual(rows: np.ndarray) -> None:
    rows["timing"]["wakeup_us"] = rows["timing"]["compute_us"] = 0.0


def standing(rows: np.ndarray) -> None:
    rows["state"]["state"] = int(State.STANDBY)


@pytest.mark.parametrize(
    ("changed", "what", "note"),
    [(virtual, "timing", "in virtual time"), (standing, "path", "never ACTIVE")],
)
def test_a_run_that_shows_nothing_beside_others_is_noted(
    paths: list[Path], tmp_path: Path, changed, what: str, note: str
) -> None:
    rows = cycles(200)
    changed(rows)
    other = record(tmp_path / "other", 200, rows=rows, raw_frames=False)
    (axes,) = drawn(what, paths[0], other).axes
    texts = [text.get_text() for text in axes.get_legend().get_texts()]
    assert f"other: {note}" in " ".join(texts)


@pytest.mark.parametrize(
    ("changed", "what", "words"),
    [
        (virtual, "timing", "virtual time"),
        (standing, "path", "never ACTIVE"),
        (standing, "envelope", "never armed"),
        (standing, "spectra", "long enough"),
    ],
)
def test_what_a_log_cannot_show_is_said(tmp_path: Path, changed, what: str, words: str) -> None:
    rows = cycles(200)
    changed(rows)
    path = record(tmp_path, 200, rows=rows, raw_frames=False)
    told = CliRunner().invoke(command, ["figure", str(path), "--what", what])
    assert isinstance(told.exception, ToolError)
    assert words in str(told.exception)
    assert not (tmp_path / f"run.{what}.png").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "no log is named"),
        (["LOG", "--out", "OUT/x.gif"], ".png, .svg, .pdf"),
        (["LOG", "--out", "OUT/no/x.png"], "choose another with --out"),
        (["LOG"] * 8, "shows 7 at most"),
    ],
)
def test_what_cannot_be_drawn_is_refused_in_one_line(
    paths: list[Path], tmp_path: Path, arguments: Sequence[str], words: str
) -> None:
    given = [each.replace("LOG", str(paths[0])).replace("OUT", str(tmp_path)) for each in arguments]
    told = CliRunner().invoke(command, ["figure", *given])
    assert isinstance(told.exception, ToolError)
    assert words in str(told.exception)
    assert "\n" not in str(told.exception)
