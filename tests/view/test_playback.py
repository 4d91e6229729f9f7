"""A log played back: clock, decoding around the moment shown, several logs, damage, markup."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest
from viewer_bench import Viewer, free_port, opened, recorded

from tonus.runtime.states import State
from tonus.tools.errors import ToolError
from tonus.tools.log import open as open_log
from tonus.tools.view import viewer
from tonus.tools.view.gate import Gate
from tonus.tools.view.moment import Happening, Samples
from tonus.tools.view.playback import Playback
from tonus.tools.view.recorded import Recorded
from tonus.tools.view.signals import names_of, plots_of, series_of
from tonus.tools.view.words import happening

pytestmark = pytest.mark.wide


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("playback"))


@pytest.fixture
def playback(file: Path) -> Iterator[Playback]:
    made = Playback([Recorded(file)])
    yield made
    made.close()


def test_a_moment_is_the_record_of_its_time(playback: Playback, file: Path) -> None:
    log = open_log(file)
    times = (log.times("/tonus/pose") - log.times("/tonus/pose")[0]) * 1e-9
    playback.play(playing=False)
    for time_s in (0.5, 3.3, 1.02, playback.length_s, 0.1):
        playback.seek(time_s)
        moment = playback.advance(5.0)[0]
        assert moment.time_s == pytest.approx(time_s)
        assert moment.jumped
        at = int(np.searchsorted(times, time_s, "right")) - 1
        shown = int(moment.newest["timing"]["tick"][0])
        assert 0 <= int(log["/tonus/timing"]["tick"][at]) - shown <= 20
        row = np.flatnonzero(log["/tonus/timing"]["tick"] == shown)[0]
        for topic in ("pose", "tension", "drives", "envelope"):
            assert moment.newest[topic][0] == log[f"/tonus/{topic}"][row]


def test_a_signal_is_shown_once_in_order_without_gap(playback: Playback) -> None:
    found = [playback.advance(0.033)[0].samples.times for _ in range(1000)]
    times = np.concatenate(found)
    assert times[-1] > playback.length_s - 0.05
    assert np.diff(times) == pytest.approx(0.02, abs=1e-6)
    assert not playback.playing, "it ends in a pause"


def test_a_jump_during_the_reading_is_of_the_next_moment(
    playback: Playback, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pages jump in a thread of their own; a moment's time is that of its samples."""
    (log,) = playback.logs
    playback.play(playing=False)
    playback.seek(1.0)
    read = log.samples

    def interrupted(start_s: float, end_s: float) -> Samples:
        found = read(start_s, end_s)
        monkeypatch.undo()
        playback.seek(3.0)
        return found

    monkeypatch.setattr(log, "samples", interrupted)
    moments = [playback.advance(0.03)[0] for _ in range(2)]
    assert [moment.time_s for moment in moments] == [1.0, 3.0]
    ticks = [moment.newest["timing"]["tick"][0] for moment in moments]
    wanted = [read(0.0, time_s).rows["timing"]["tick"][-1] for time_s in (1.0, 3.0)]
    assert ticks == wanted
    assert moments[1].jumped


def test_speed_and_pause(playback: Playback) -> None:
    playback.set_speed(2.1)
    assert playback.speed == 2.0
    playback.advance(0.5)
    assert playback.time_s == pytest.approx(1.0)
    playback.play(playing=False)
    playback.advance(0.5)
    assert playback.time_s == pytest.approx(1.0)


def test_two_logs_are_aligned_at_their_start(file: Path, tmp_path: Path) -> None:
    """Of which the second was longer on its way to START."""
    playback = Playback([Recorded(file), Recorded(recorded(tmp_path, pretension_s=1.2))])
    started = [log.started_s() for log in playback.logs]
    assert started[1] - started[0] > 0.5
    playback.seek(started[1] + 0.1)
    first, second = playback.advance(0.0)
    for moment in (first, second):
        assert State(int(moment.newest["state"]["state"][0])) is State.ACTIVE
        assert moment.newest["state"]["elapsed"] == pytest.approx(0.1, abs=0.03)
    playback.close()


def test_a_damaged_log_is_shown_as_far_as_it_goes(tmp_path: Path, file: Path) -> None:
    cut = tmp_path / "cut.mcap"
    data = file.read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    log = Recorded(cut)
    assert log.damage
    assert 0.5 < log.length_s < Recorded(file).length_s - 0.5
    assert len(log.samples(0.0, log.length_s))
    log.close()


def test_what_is_no_log_is_refused_in_a_line(tmp_path: Path) -> None:
    other = tmp_path / "other.mcap"
    other.write_bytes(b"nothing")
    with pytest.raises(ToolError, match="other"):
        Recorded(other)


def test_every_signal_and_plot_can_be_taken(playback: Playback) -> None:
    config = playback.logs[0].config
    samples = playback.logs[0].samples(2.0, 3.0)
    assert 49 <= len(samples) <= 50
    names = names_of(config)
    assert len(names) > 300
    for name in names:
        series = series_of(name)
        assert series is not None
        assert series.take(samples).shape == (len(samples),)
    for plot in plots_of(config):
        for line in plot.series:
            assert line.take(samples).shape == (len(samples),)
    assert series_of("drives.rate[0]; import os") is None


def test_what_an_event_says_is_text_for_the_page() -> None:
    """The page sets it as textContent; here it goes through unchanged and with nothing added."""
    text = "<img src=x onerror=alert(1)>"
    told = happening(0, Happening(1.0, 40, "cable_torn", text, text))
    assert told["text"] == told["where"] == text
    assert "replace" in told["remedy"]


def test_a_page_plays_pauses_seeks_and_chooses(tmp_path: Path, file: Path) -> None:
    viewer = Viewer(tmp_path, str(file))
    try:
        with opened(viewer) as page:
            assert page.hello["length_s"] > 5.0
            assert page.next("points")["runs"][0]["t"]
            page.send(do="pause")
            page.until(lambda now: not now["playing"])
            page.send(do="seek", value=4.0)
            stood = page.until(lambda now: now["t"] == 4.0)
            assert stood["runs"][0]["state"]
            page.send(do="choose", signals=["drives.rate[0]", "truth.position[2]"])
            run = page.next("points")["runs"][0]
            while not run["chosen"]:
                run = page.next("points")["runs"][0]
            assert [len(line) for line in run["chosen"]] == [len(run["t"])] * 2
            page.send(do="play")
            page.until(lambda now: now["t"] > 4.2)
            assert {event["name"] for event in page.events} >= {"state", "operator"}
    finally:
        viewer.close()


def test_a_viewer_ends_wherever_in_its_loop_a_signal_interrupts_it(file: Path) -> None:
    """A signal's handler runs in the main thread between any two lines, also where that thread
    holds the lock of what it waits with. Here it comes in the n-th line of the loop, and of what
    the loop calls in `threading`."""
    for number in range(1, 61):
        gate = Gate("127.0.0.1", free_port(), None)
        shown = viewer.Viewer(gate, None, Playback([Recorded(file)]))
        running = threading.Thread(target=_interrupted, args=(shown, number), daemon=True)
        running.start()
        running.join(20)
        assert not running.is_alive(), f"it did not end after a signal in line {number}"
        shown.release()


def _interrupted(shown: viewer.Viewer, number: int) -> None:
    left = number

    def trace(frame: FrameType, event: str, _: Any) -> Any:
        nonlocal left
        caller = frame.f_back
        own = frame.f_code is viewer.Viewer.run.__code__
        called = frame.f_code.co_filename == threading.__file__ and caller and caller.f_trace
        if not (own or called):
            return None
        left -= event == "line"
        if left == 0:
            sys.settrace(None)
            shown.close()
        return trace

    sys.settrace(trace)
    shown.run()
    sys.settrace(None)
