"""The page in a real browser: Chromium, headless, drawing in software.

The browser's own work is not what is timed here: a host without a graphics processor draws only
some pictures a second, and stands still for seconds while it compiles what it draws with.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from viewer_bench import GOLDEN, Served, Viewer, recorded

from tests.bench.drawn import CHROMIUM, OPTIONS
from tonus.runtime.timing import clock
from tonus.tools.view.recorded import Recorded

TOKEN = "a-token-for-browsers"  # noqa: S105
PATIENCE_MS = 120_000.0

NAME = "<b onload=alert(1)>name"
MARKUP = (
    "</td><img src=x onerror=alert(1)><svg onload=alert(2)>"
    "<script>window.marked = 1; alert(3)</script>"
)

_RECORDING = """
window.recording = [];
window.shows = showNow;
showNow = () => {
  shows();
  const state = document.getElementById("state").textContent;
  if (now.runs) recording.push({ state, height: now.runs[0].position[2] });
};
null
"""

_HELD = """
if (location.pathname.startsWith("/scene")) window.requestAnimationFrame = () => 1;
"""

pytestmark = [
    pytest.mark.wide,
    pytest.mark.skipif(
        CHROMIUM is None, reason="no chromium on this host: apt-get install chromium"
    ),
]
sync_api = pytest.importorskip("playwright.sync_api", reason="pip install playwright")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as playwright:
        made = playwright.chromium.launch(executable_path=CHROMIUM, args=OPTIONS)
        yield made
        made.close()


class Shown:
    """A page of a viewer."""

    def __init__(self, browser: Any, address: str, *, held: bool = False) -> None:
        """``held``: the scene is loaded and told everything, but neither it nor a plot is drawn."""
        width, height = (480, 360) if held else (1200, 750)
        self.page = browser.new_page(viewport={"width": width, "height": height})
        self.page.set_default_timeout(PATIENCE_MS)
        if held:
            self.page.add_init_script(_HELD)
        self.problems: list[str] = []
        self.page.on("pageerror", lambda error: self.problems.append(str(error)))
        self.page.on("dialog", lambda dialog: self.problems.append("a dialog: markup was run"))
        self.page.goto(address)
        self.until("document.getElementById('time').textContent != ''")
        if held:
            self.click("#pause")

    def until(self, condition: str) -> None:
        # The page's policy forbids the eval that Playwright's own wait needs.
        latest = clock.wall_seconds() + 1e-3 * PATIENCE_MS
        while clock.wall_seconds() < latest:
            if self.page.evaluate(f"Boolean({condition})"):
                return
            clock.pause(0.1)
        raise AssertionError(f"never so: {condition}")

    def state(self, name: str) -> None:
        self.until(f"document.getElementById('state').textContent == '{name}'")

    def record(self) -> None:
        """From now on the page keeps the state in its top line and the height above home, mm, of
        each moment that it has shown: what happens between two questions is found there."""
        self.evaluate(_RECORDING)

    def recorded(self, condition: str) -> None:
        """Until the page has shown an ``each`` (state, height) of which this is so."""
        self.until(f"recording.some((each) => {condition})")

    def press(self, verb: str) -> None:
        self.until(f"!document.querySelector('[data-verb={verb}]').disabled")
        self.evaluate("document.getElementById('reply').textContent = ''")
        # By the element itself: a mouse would wait for a picture that is drawn slowly.
        self.click(f"[data-verb={verb}]")
        self.until("document.getElementById('reply').textContent")
        assert "refused" not in self.text("reply"), self.text("reply")

    def seek(self, time_s: float) -> None:
        """Until the page shows this moment."""
        self.evaluate(f"send({{do: 'seek', value: {time_s}}})")
        self.until(f"Math.abs(now.t - {time_s}) < 0.002")

    def text(self, name: str) -> str:
        return str(self.evaluate(f"document.getElementById('{name}').textContent"))

    def click(self, selector: str) -> None:
        self.page.eval_on_selector(selector, "each => each.click()")

    def evaluate(self, text: str) -> Any:
        return self.page.evaluate(text)

    def close(self) -> None:
        self.page.close()
        assert not self.problems


def test_two_logs_are_played_sought_and_compared(browser: Any, tmp_path: Path) -> None:
    """Of which the second took longer to its START."""
    logs = [recorded(tmp_path), recorded(tmp_path, "later", pretension_s=1.2)]
    started = [Recorded(log).started_s() for log in logs]
    assert started[1] - started[0] > 0.5
    viewer = Viewer(tmp_path, *map(str, logs))
    shown = Shown(browser, viewer.address)
    try:
        shown.until("document.querySelectorAll('#marks i').length > 15")
        shown.until("plots[0].runs.length == 2 && plots[0].runs[0].t.length > 5")
        shown.evaluate("send({do: 'pause'})")
        shown.until("document.getElementById('play').textContent == 'Play'")
        shown.seek(started[1] - 0.1)
        assert shown.text("state") == "PRETENSION | PRETENSION"
        shown.seek(started[1] + 1.0)
        assert shown.text("state") == "ACTIVE | ACTIVE"
        assert shown.evaluate("now.runs.map((run) => run.elapsed)") == [1.0, 1.0]
        assert "start" in shown.text("events")
        shown.until(f"document.getElementById('at').textContent.startsWith('{started[1] + 1:.2f}')")
        shown.click("#play")
        shown.until(f"now.t > {started[1] + 1.2}")
        drawn = "document.getElementById('scene').contentDocument.querySelectorAll('canvas').length"
        shown.until(f"{drawn} > 0")
    finally:
        shown.close()
        viewer.close()


def test_markup_of_a_log_is_shown_as_text(browser: Any, tmp_path: Path) -> None:
    """In the name of its file, in the name, the place and the text of its events, and in a signal
    that a page is asked to show."""
    marked = tmp_path / f"{NAME}.mcap"
    with_events(GOLDEN, marked, (NAME, NAME, MARKUP))
    viewer = Viewer(tmp_path, str(marked))
    shown = Shown(browser, viewer.address)
    try:
        shown.until("document.querySelectorAll('#marks i').length > 1")
        assert NAME in shown.text("title")
        events = shown.text("events")
        assert MARKUP in events
        assert events.count(NAME) >= 2
        shown.evaluate(f"choose([{NAME!r}])")
        assert NAME in shown.text("chosen")
        made = "document.querySelectorAll('img, svg, b, [onerror], [onload], script:not([src])')"
        assert shown.evaluate(f"{made}.length") == 0
        assert shown.evaluate("window.marked") is None
        assert shown.evaluate("document.title").endswith(f"{NAME}.mcap")
    finally:
        shown.close()
        viewer.close()


def with_events(source: Path, target: Path, words: tuple[str, str, str]) -> None:
    """A log as another one, but each event has this name, place and text."""
    with source.open("rb") as file, target.open("wb") as out:
        reader, writer = make_reader(file), Writer(out)
        writer.start(profile="ros2", library="another")
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            if schema.id not in schemas:
                described = schema.name, schema.encoding, schema.data
                schemas[schema.id] = writer.register_schema(*described)
            if channel.id not in channels:
                described = channel.topic, channel.message_encoding, schemas[schema.id]
                channels[channel.id] = writer.register_channel(*described)
            data = message.data
            if channel.topic == "/tonus/events":
                # Header, tick and level; then each text with its length, on a multiple of four.
                data = data[:13]
                for word in words:
                    text = word.encode() + bytes(1)
                    data += bytes(-len(data) % 4) + struct.pack("<I", len(text)) + text
            number = channels[channel.id]
            writer.add_message(number, message.log_time, data, message.publish_time)
        for each in reader.iter_attachments():
            kept = each.create_time, each.log_time, each.name, each.media_type, each.data
            writer.add_attachment(*kept)
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        writer.finish()


_TOLD = """
(() => {
  showNow = () => {};  // what the log tells is not in the way
  hello = { ...hello, asked: true, operate: true };
  const item = { ok: true, item: "drives", text: "8 answer" };
  const status = { scenarios: ["a"], served: true, scenario: "a", tunable: [], self_test: [item] };
  const choices = [{ verb: "arm", why: "", about: "" }, { verb: "stop", why: "off", about: "" }];
  const seen = new MutationObserver(() => {});
  const all = { attributes: true, childList: true, characterData: true, subtree: true };
  seen.observe(document.body, all);
  const tell = (status, choices) => {
    for (let picture = 0; picture < 30; picture++) {
      // Each picture is a message of its own, and so are the objects in it.
      now = JSON.parse(JSON.stringify({ ...now, n: picture, status, choices }));
      showOperation();
      if (!picture) seen.takeRecords();
    }
    const again = seen.takeRecords().length, arm = document.querySelector("[data-verb=arm]");
    const list = document.getElementById("selftest").textContent;
    return { arm: arm.disabled, title: arm.title, list, again };
  };
  return [
    tell(status, choices),
    tell({ ...status, self_test: [{ ...item, ok: false, text: "7 answer" }] }, choices),
    tell(status, [{ ...choices[0], why: "not ready" }, choices[1]]),
  ];
})()
"""


def test_buttons_and_self_test_are_made_anew_for_a_new_status_only(
    browser: Any, tmp_path: Path
) -> None:
    """Pictures come 30 times a second: a page that drew all of this each time would fall behind."""
    viewer = Viewer(tmp_path, str(GOLDEN), token=TOKEN)
    shown = Shown(browser, viewer.address, held=True)
    try:
        shown.until("hello")
        ready, worse, refused = shown.evaluate(_TOLD)
        assert [each["again"] for each in (ready, worse, refused)] == [0, 0, 0]
        assert [each["arm"] for each in (ready, worse, refused)] == [False, False, True]
        assert "8 answer" in ready["list"]
        assert "7 answer" in worse["list"]
        assert "8 answer" in refused["list"]
        assert refused["title"] == "not ready"
    finally:
        shown.close()
        viewer.close()


def test_a_slave_of_a_segment_is_pulled_with_a_click(browser: Any, tmp_path: Path) -> None:
    daemon = Served(tmp_path, "config/ethercat.yaml", "--virtual")
    viewer = Viewer(tmp_path, "--operate", token=TOKEN)
    shown = Shown(browser, viewer.address)
    try:
        shown.state("STANDBY")
        shown.evaluate("document.getElementById('lab').open = true")
        shown.until("document.querySelectorAll('#nodes button').length == 10")
        shown.click("[data-node='tonus0/3']")
        shown.until("document.querySelector(\"[data-node='tonus0/3']\").textContent == 'Plug in'")
        rows = "[...document.getElementById('nodes').rows].map((row) => row.cells[2].textContent)"
        states = shown.evaluate(rows)
        assert states[2] == "unplugged"
        assert set(states[3:]) == {"cut off"}
        assert "cut off" not in states[:2]
        shown.click("[data-node='tonus0/3']")
        shown.until("document.querySelector(\"[data-node='tonus0/3']\").textContent == 'Unplug'")
    finally:
        shown.close()
        viewer.close()
        daemon.close()


def test_a_session_in_virtual_time(browser: Any, tmp_path: Path) -> None:
    _session(browser, tmp_path, "--virtual")


@pytest.mark.realtime
def test_a_session_in_real_time(browser: Any, tmp_path: Path) -> None:
    _session(browser, tmp_path, held=True)


def _session(browser: Any, folder: Path, *arguments: str, held: bool = False) -> None:
    """Arm, start, see it move, pull a node with a click, see fault and stop, reset.

    ``held``: without a graphics processor the first pictures of a scene are seconds of work, for
    which daemon and lab in real time leave no time: the pictures are those of the session in
    virtual time.
    """
    daemon = Served(folder, "config/can.yaml", *arguments)
    viewer = Viewer(folder, "--operate", token=TOKEN)
    shown = Shown(browser, viewer.address, held=held)
    try:
        shown.state("STANDBY")
        shown.record()
        # A page that is drawn this slowly shows too few signs of life to be watching.
        shown.evaluate("document.getElementById('watch').checked = false")
        shown.until("document.querySelectorAll('#selftest li').length > 3")
        shown.press("arm")
        shown.state("HOLD")
        shown.evaluate("command('scenario', {name: 'sine_z'})")
        shown.until("now && now.status.scenario == 'sine_z'")
        shown.press("start")
        shown.recorded("each.state == 'ACTIVE' && each.height > 5")
        shown.recorded("each.state == 'ACTIVE' && each.height < -5")
        shown.evaluate("document.getElementById('lab').open = true")
        shown.until("document.querySelectorAll('#nodes button').length > 10")
        shown.click("[data-node='can1/3']")
        shown.state("FAULT")
        assert "can1" in shown.text("fault")
        assert "What to do" in shown.text("fault")
        shown.until("document.querySelector(\"[data-node='can1/3']\").textContent == 'Plug in'")
        shown.click("[data-node='can1/3']")
        shown.until("document.querySelector(\"[data-node='can1/3']\").textContent == 'Unplug'")
        shown.press("reset")
        shown.state("STANDBY")
        shown.page.keyboard.press("Escape")
        shown.state("FAULT")
    finally:
        shown.close()
        viewer.close()
        daemon.close()
