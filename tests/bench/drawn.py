"""When a browser has drawn a viewer's first picture: Chromium, headless, drawing in software.

The browser is open before, on another page. A host with a graphics processor draws sooner.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tonus.runtime.timing import clock

CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser") if (path := shutil.which(name))), None
)
OPTIONS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    # Plots and text drawn by the processor directly: through the emulated graphics processor they
    # take more time than the scene.
    "--disable-gpu-rasterization",
    "--disable-accelerated-2d-canvas",
]
_PATIENCE_S = 120.0

_WATCHED = """
(() => {
  const seen = (window.seen = {});
  const mark = (name) => { seen[name] ??= performance.timeOrigin + performance.now(); };
  mark("document");
  const asked = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
    if (String(kind).startsWith("webgl")) mark("client");
    return asked.call(this, kind, ...more);
  };
  // Lines are drawn as instances, and the cables are lines. Two frames on they have been shown.
  const draw = WebGL2RenderingContext.prototype.drawElementsInstanced;
  WebGL2RenderingContext.prototype.drawElementsInstanced = function (...more) {
    if (!("lines" in seen)) requestAnimationFrame(() => requestAnimationFrame(() => mark("drawn")));
    mark("lines");
    return draw.apply(this, more);
  };
})();
"""
_ASKED = "[window.seen, document.getElementById('scene').contentWindow.seen || {}]"

Steps = dict[str, float]
"""s of `clock.wall_seconds` at which each was reached"""


@contextmanager
def browser(shot: Path | None = None) -> Iterator[Callable[[str], Steps] | None]:
    """Opens an address and gives the times of its steps: the page's document, the client of the
    scene, the first lines given to the graphics, the picture drawn; at last a ``shot`` of the page.
    None where there is no browser."""
    try:
        from playwright import sync_api
    except ModuleNotFoundError:
        yield None
        return
    if CHROMIUM is None:
        yield None
        return
    with sync_api.sync_playwright() as playwright:
        made = playwright.chromium.launch(executable_path=CHROMIUM, args=OPTIONS)
        page = made.new_page(viewport={"width": 1200, "height": 750})
        page.set_default_timeout(1e3 * _PATIENCE_S)
        page.add_init_script(_WATCHED)

        def opened(address: str) -> Steps:
            page.goto(address, wait_until="commit")
            found = _steps(page)
            if shot is not None:
                page.screenshot(path=shot)
            return found

        yield opened
        made.close()


def _steps(page: Any) -> Steps:
    latest = clock.wall_seconds() + _PATIENCE_S
    while clock.wall_seconds() < latest:
        if page.evaluate("Boolean(document.getElementById('scene'))"):
            outer, scene = page.evaluate(_ASKED)
            if "drawn" in scene:
                steps = {"page": outer["document"]}
                steps |= {name: scene[name] for name in ("client", "lines", "drawn")}
                since_1970 = 1e-9 * clock.utc_offset_ns()
                return {name: 1e-3 * at - since_1970 for name, at in steps.items()}
        clock.pause(0.05)
    raise TimeoutError("the browser has drawn no line")
