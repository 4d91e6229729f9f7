"""`tonus log report` on runs in the lab: one page, whole in itself, and first how it ended."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from tests.loop import QUICK
from tonus.tools.errors import ToolError
from tonus.tools.log import open as open_log
from tonus.tools.report.figures import Cloud
from tonus.tools.report.interactive import available
from tonus.tools.report.page import report
from tonus.tools.report.panels import position_error
from tonus.tools.report.story import Story
from tonus.tools.report.thin import thin
from tonus.tools.run.summary import Indicators, summarise
from tonus.tools.testing.player import Player

pytestmark = pytest.mark.tonus(config="config/direct.yaml", overrides=QUICK)

SECTIONS = ["time", "envelope", "spectra", "timing", "events", "settings"]
if available():
    SECTIONS = ["look", *SECTIONS]
WINDOWS = {
    "tracking error, RMS": "ACTIVE",
    "tension, lowest": "HOLD and ACTIVE",
    "K_eq, highest": "HOLD and ACTIVE",
    "contact force, highest": "the whole run",
    "speed, highest": "the whole run",
}


class Page(HTMLParser):
    """What a browser would need and show."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.sections: list[str] = []
        self.fetched: list[str] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag == "h2":
            self.sections.append(given["id"] or "")
        self.fetched += [value or "" for name, value in attrs if name == "src"]
        self.fetched += [given.get("href") or ""] if tag == "link" else []

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(self.words)


@pytest.fixture(scope="module")
def quiet(tonus_shared_run: Player) -> Path:
    return tonus_shared_run("sine_x", duration=0.8).path


def page_of(log: Path, out: Path) -> tuple[Page, list[float]]:
    shares: list[float] = []
    report(log, out, shares.append)
    return Page(out.read_text(encoding="utf-8")), shares


def test_times_count_from_where_those_of_log_info_do(tonus_run: Player) -> None:
    """The first message, which is a frame of the bring-up here, and not the first tick."""
    log = tonus_run("hold", config="config/can.yaml", duration=0.1).log
    begins = log.times("/tonus/timing")[0] - log.start_ns
    assert begins > 0
    assert Story(log).time[0] == begins * 1e-9


def test_a_page_is_whole_in_itself_and_begins_with_the_verdict(quiet: Path, tmp_path: Path) -> None:
    out = tmp_path / "report.html"
    page, shares = page_of(quiet, out)
    _loads_nothing_from_elsewhere(out.read_text(encoding="utf-8"))
    assert page.sections == SECTIONS
    assert page.fetched
    assert all(source.startswith("data:image/") for source in page.fetched)
    assert "Completed without a fault; ended in STANDBY" in page.text
    assert page.text.index("Completed") < page.text.index("tracking error, RMS")
    for figure, window in WINDOWS.items():
        assert re.search(rf"{figure} [^,]*? (truth|commanded|estimate) {window} ", page.text)
    assert "OUTSIDE" not in page.text
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)


@pytest.mark.long
@pytest.mark.tonus_expect("*")
def test_a_fault_is_named_first_and_shown_from_near(tonus_run: Player, tmp_path: Path) -> None:
    fault = {"kind": "unplug", "channel": "can1", "node": 3, "at": 1.0}
    run = tonus_run("hold", config="config/can.yaml", faults=[fault])
    page, _ = page_of(run.path, tmp_path / "report.html")
    assert len(page.sections) == len(SECTIONS) + 1
    assert "drive_lost" in page.text.partition("tracking error")[0]
    assert "can1/3" in page.text


def test_a_damaged_log_is_shown_up_to_the_damage_and_says_so(quiet: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(quiet.read_bytes()[: quiet.stat().st_size // 2])
    page, _ = page_of(cut, tmp_path / "report.html")
    assert "The log is damaged" in page.text
    assert "time" in page.sections


def test_what_is_no_log_of_a_run_ends_in_one_line(tmp_path: Path) -> None:
    other = tmp_path / "other.mcap"
    other.write_bytes(b"not a log at all")
    with pytest.raises(ToolError) as refused:
        report(other, tmp_path / "report.html", lambda _: None)
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "report.html").exists()


def test_a_run_in_pieces_comes_to_what_the_whole_one_comes_to(
    quiet: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = Story(open_log(quiet))
    (at_once,) = whole.pieces()
    monkeypatch.setattr("tonus.tools.report.story._PIECE", 700)
    story, indicators = Story(open_log(quiet)), Indicators()
    cloud, errors = Cloud(story), []
    for piece in story.pieces():
        assert len(piece.time) <= 700
        indicators.add(piece.log)
        cloud.add(piece)
        errors.append(position_error(piece)[1])
    np.testing.assert_array_equal(np.concatenate(errors), position_error(at_once)[1])
    expected = Cloud(whole)
    expected.add(at_once)
    for ours, theirs in zip(cloud.points(), expected.points(), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    summed, told = indicators.told(), summarise(open_log(quiet))
    for name in ("tracking_rmse_m", "tension_rmse_n"):
        assert summed.pop(name) == pytest.approx(told[name], rel=1e-12)
    assert summed == {name: told[name] for name in summed}
    assert story.bands == whole.bands


@pytest.mark.wide
def test_a_run_in_several_files_is_reported_whole(tonus_run: Player, tmp_path: Path) -> None:
    several = {"recording.rotate_s": 1.0, "recording.chunk_ms": 200}
    run = tonus_run("hold", overrides=several, duration=0.5)
    assert run.path.with_name("run.2.mcap").exists()
    page, _ = page_of(run.path, tmp_path / "report.html")
    assert f"{len(run.log['/tonus/timing'])} cycles" in page.text


def test_thinned_curves_keep_every_peak() -> None:
    time = np.linspace(0.0, 10.0, 100_000)
    values = np.sin(time)
    values[54_321], values[70_001] = 9.0, -9.0
    t, y = thin(time, values, 500)
    assert len(t) <= 1000
    assert (y.max(), y.min()) == (9.0, -9.0)
    assert (np.diff(t) >= 0.0).all()


def _loads_nothing_from_elsewhere(text: str) -> None:
    assert "<script src" not in text
    visible = re.sub(r"data:image/[^\"]*|<script[^>]*>.*?</script>", "", text, flags=re.DOTALL)
    assert not re.search(r"https?://", visible)
