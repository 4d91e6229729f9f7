"""The page in a real browser: Chromium, headless, drawing in software.

The browser's own work is not what is timed here: a host without a graphics processor draws a
picture or two a second while others compute.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from viewer_bench import Served, Viewer, recorded

from tonus.runtime.timing import clock

CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser") if (path := shutil.which(name))), None
)
TOKEN = "a-token-for-browsers"  # noqa: S105
PATIENCE_MS = 120_000.0

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(
        CHROMIUM is None, reason="no chromium on this host: apt-get install chromium"
    ),
]
sync_api = pytest.importorskip("playwright.sync_api", reason="pip install playwright")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as playwright:
        options = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
        made = playwright.chromium.launch(
            executable_path=CHROMIUM, args=[*options, "--enable-unsafe-swiftshader"]
        )
        yield made
        made.close()


class Shown:
    """A page of a viewer."""

    def __init__(self, browser: Any, address: str) -> None:
        self.page = browser.new_page(viewport={"width": 1200, "height": 750})
        self.page.set_default_timeout(PATIENCE_MS)
        self.problems: list[str] = []
        self.page.on("pageerror", lambda error: self.problems.append(str(error)))
        self.page.on("dialog", lambda dialog: self.problems.append("a dialog: markup was run"))
        self.page.goto(address)
        self.until("document.getElementById('time').textContent != ''")

    def until(self, condition: str) -> None:
        # The page's policy forbids the eval that Playwright's own wait needs.
        for _ in range(int(PATIENCE_MS / 100)):
            if self.page.evaluate(f"Boolean({condition})"):
                return
            clock.pause(0.1)
        raise AssertionError(f"never so: {condition}")

    def state(self, name: str) -> None:
        self.until(f"document.getElementById('state').textContent == '{name}'")

    def press(self, verb: str) -> None:
        self.until(f"!document.querySelector('[data-verb={verb}]').disabled")
        # By the element itself: a mouse would wait for a picture that is drawn slowly.
        self.page.eval_on_selector(f"[data-verb={verb}]", "each => each.click()")

    def click(self, selector: str) -> None:
        self.page.eval_on_selector(selector, "each => each.click()")

    def evaluate(self, text: str) -> Any:
        return self.page.evaluate(text)

    def close(self) -> None:
        self.page.close()
        assert not self.problems


def test_a_log_is_played_sought_and_compared(browser: Any, tmp_path: Path) -> None:
    file = recorded(tmp_path)
    viewer = Viewer(tmp_path, str(file), str(file))
    shown = Shown(browser, viewer.address)
    try:
        shown.until("document.querySelectorAll('#marks i').length > 5")
        shown.until("plots[0].runs.length == 2 && plots[0].runs[0].t.length > 5")
        shown.click("#play")
        shown.until("document.getElementById('play').textContent == 'Play'")
        shown.evaluate("send({do: 'seek', value: 5})")
        shown.until("now && now.t == 5")
        assert "state" in shown.evaluate("document.getElementById('events').textContent")
        drawn = "document.getElementById('scene').contentDocument.querySelectorAll('canvas').length"
        shown.until(f"{drawn} > 0")
    finally:
        shown.close()
        viewer.close()


def test_a_session_in_virtual_time(browser: Any, tmp_path: Path) -> None:
    _session(browser, tmp_path, "--virtual")


@pytest.mark.realtime
def test_a_session_in_real_time(browser: Any, tmp_path: Path) -> None:
    _session(browser, tmp_path)


def _session(browser: Any, folder: Path, *arguments: str) -> None:
    """Arm, start, see it move, pull a node with a click, see fault and stop, reset."""
    daemon = Served(folder, "config/can.yaml", *arguments)
    viewer = Viewer(folder, "--operate", token=TOKEN)
    shown = Shown(browser, viewer.address)
    try:
        shown.state("STANDBY")
        # A page that is drawn this slowly shows too few signs of life to be watching.
        shown.evaluate("document.getElementById('watch').checked = false")
        shown.until("document.querySelectorAll('#selftest li').length > 3")
        shown.press("arm")
        shown.state("HOLD")
        shown.evaluate("command('scenario', 'sine_z')")
        shown.until("now && now.status.scenario == 'sine_z'")
        shown.press("start")
        shown.state("ACTIVE")
        shown.until("now && now.runs[0].position[2] > 5")
        shown.until("now && now.runs[0].position[2] < -5")
        shown.evaluate("document.getElementById('lab').open = true")
        shown.until("document.querySelectorAll('#nodes button').length > 10")
        shown.click("[data-node='can1/3']")
        shown.state("FAULT")
        assert "can1" in shown.evaluate("document.getElementById('fault').textContent")
        assert "What to do" in shown.evaluate("document.getElementById('fault').textContent")
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
