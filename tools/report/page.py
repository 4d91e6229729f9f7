"""report.html: one page that tells a run, verdict first, and needs nothing but itself."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterator
from html import escape
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from tonus.tools.draft import write_whole
from tonus.tools.errors import ToolError
from tonus.tools.log import open as open_log
from tonus.tools.report import figures, panels
from tonus.tools.report.pieces import Piece, Progress
from tonus.tools.report.story import Story
from tonus.tools.report.verdict import Verdict, judge
from tonus.tools.run.summary import Indicators

_BEFORE_S, _AFTER_S = 0.6, 0.4
"""s round a fault that are drawn tick by tick"""
_FAULTS = 3
"""that are drawn from near"""
_EVENTS = 500
"""rows of a table"""
_OUTLINE, _READING = 0.3, 0.8
"""shares of the work that are done when the run's states and its cycles have been read"""
_OVER_TIME = (
    *(panels.force, panels.stiffness, panels.tension, panels.error),
    *(panels.tension_error, panels.path, panels.speed),
)
_NEAR = (panels.force, panels.stiffness, panels.tension, panels.speed)
_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;max-width:1180px;margin:1.5rem auto;padding:0 1rem;
color:#111}
h1{font-size:1.35rem;margin:0 0 .3rem}h2{font-size:1.1rem;margin:2rem 0 .5rem}
.verdict{padding:.8rem 1rem;border-left:.5rem solid;margin:1rem 0}
.good{border-color:#0072B2;background:#E8F1F8}.bad{border-color:#D55E00;background:#FBEBE0}
.verdict p{margin:.2rem 0}.verdict b{font-size:1.2rem}
table{border-collapse:collapse;margin:.5rem 0}td,th{padding:.15rem .8rem .15rem 0;text-align:left;
border-bottom:1px solid #ddd;vertical-align:top}
td.n{text-align:right;font-variant-numeric:tabular-nums}
.out{color:#B34700;font-weight:600}img{width:100%;height:auto}img.part{max-width:860px}
pre{background:#f5f5f5;padding:.6rem;overflow:auto;font-size:13px}summary{cursor:pointer}
nav a{margin-right:1rem}
"""


def report(file: Path, out: Path, progress: Progress) -> Verdict:
    """Write the page of a log; ``progress`` receives the share that is done.

    Raises ToolError when there is nothing to show or no place to write to.
    """
    story = Story(open_log(file), progress=lambda share: progress(_OUTLINE * share))
    content = _Content(story, lambda share: progress(_OUTLINE + (_READING - _OUTLINE) * share))
    verdict = judge(story, content.indicators)
    text = "".join(_parts(story, content, verdict, progress))
    try:
        write_whole(out, text)
    except OSError as error:
        raise ToolError(f"{out}: {error.strerror}; choose another with --out") from error
    return verdict


class _Content:
    """What the page takes from the run's pieces, in one passage through them."""

    def __init__(self, story: Story, progress: Progress) -> None:
        virtual = story.log.metadata.get("time") == "virtual"
        drawn = _OVER_TIME if virtual else (*_OVER_TIME, panels.latency)
        self.indicators, self.cloud = Indicators(), figures.Cloud(story)
        self.sheets = figures.filled(self._watched(story, progress), drawn)

    def _watched(self, story: Story, progress: Progress) -> Iterator[Piece]:
        for piece in story.pieces(progress):
            self.indicators.add(piece.log)
            self.cloud.add(piece)
            yield piece


def _parts(story: Story, content: _Content, verdict: Verdict, progress: Progress) -> Iterator[str]:
    log = story.log
    title = f"{log.metadata.get('config', 'run')}, {log.metadata.get('scenario', log.path.name)}"
    yield (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>\n"
    )
    yield f"<h1>{escape(title)}</h1><div>{escape(_subtitle(story))}</div>\n"
    yield _verdict(verdict)
    sections = list(_sections(story, content))
    yield "<nav>" + "".join(
        f'<a href="#{anchor}">{escape(heading)}</a>' for anchor, heading, _, _ in sections
    )
    yield '<a href="#events">Events</a><a href="#settings">Settings</a></nav>\n'
    for number, (anchor, heading, why_not, draw) in enumerate(sections):
        yield f'<h2 id="{anchor}">{escape(heading)}</h2>\n'
        figure = draw()
        yield f"<p>{escape(why_not)}</p>\n" if figure is None else _image(figure, heading)
        progress(_READING + (1.0 - _READING) * (number + 1) / len(sections))
    yield _events(story)
    yield _settings(story)
    yield "</body></html>\n"


def _sections(
    story: Story, content: _Content
) -> Iterator[tuple[str, str, str, Callable[[], Figure | None]]]:
    """Anchor, heading, what to say where there is no picture, and the picture."""
    for number, fault in enumerate(story.faults[:_FAULTS], start=1):
        at = story.at(fault["tick"])
        between = (max(at - _BEFORE_S, 0.0), min(at + _AFTER_S, float(story.time[-1])))
        heading = f"Round the fault {fault['name']} {fault['where']}".strip()

        def near(between: tuple[float, float] = between) -> Figure:
            sheets = figures.filled([story.near(*between)], _NEAR)
            return figures.over_time(story, sheets, between)

        yield f"fault{number}", heading, "", near
    yield "time", "Over time", "", lambda: figures.over_time(story, content.sheets)
    yield (
        "envelope",
        "Tension, stiffness and force (the paper's Figure 1)",
        "The robot was never armed.",
        lambda: figures.envelope(story, content.cloud),
    )
    yield (
        "spectra",
        f"Spectra in ACTIVE (the longest stretch, its first {figures.SPECTRA_S:.0f} s)",
        "ACTIVE did not last long enough for a spectrum.",
        lambda: figures.spectra(story),
    )
    yield (
        "timing",
        "Timing",
        "No latencies: they belong to the host, and this run was in virtual time.",
        lambda: figures.timing(story),
    )


def _subtitle(story: Story) -> str:
    log, states = story.log, story.bands
    known = [
        f"{key} {log.metadata[key]}"
        for key in ("controller", "seed", "time")
        if key in log.metadata
    ]
    return ", ".join(
        [*known, f"{story.time[-1]:.3f} s", f"{len(story.time)} cycles", f"{len(states)} states"]
    )


def _verdict(verdict: Verdict) -> str:
    rows = []
    for figure in verdict.figures:
        value = "not known" if figure.value is None else f"{figure.value:.5g} {figure.unit}"
        sign = {True: "within", False: "OUTSIDE", None: ""}[figure.ok]
        style = ' class="out"' if figure.ok is False else ""
        rows.append(
            f'<tr{style}><td>{escape(figure.name)}</td><td class="n">{escape(value)}</td>'
            f"<td>{escape(figure.limit)}</td><td>{sign}</td><td>{escape(figure.against)}</td></tr>"
        )
    remarks = "".join(f"<p>{escape(remark)}</p>" for remark in verdict.remarks)
    return (
        f'<div class="verdict {"good" if verdict.good else "bad"}">'
        f"<b>{escape(verdict.headline)}</b>{remarks}</div>\n"
        "<table><tr><th>figure</th><th>value</th><th>limit</th><th></th><th>from</th></tr>\n"
        + "\n".join(rows)
        + "</table>\n"
    )


def _image(figure: Figure, heading: str) -> str:
    """A figure as SVG inside the page; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "tonus", "svg.image_inline": True}):
        figure.savefig(buffer, format="svg", dpi=150, metadata={"Date": None})
    data = base64.b64encode(buffer.getvalue()).decode()
    kind = ' class="part"' if figure.get_figwidth() < 10.0 else ""
    return f'<img{kind} alt="{escape(heading)}" src="data:image/svg+xml;base64,{data}">\n'


def _events(story: Story) -> str:
    events = story.log.events()
    rows = [
        f'<tr><td class="n">{story.seconds(event.time_ns):.3f}</td><td class="n">{event.tick}</td>'
        f"<td>{escape(event.name)}</td><td>{escape(event.where)}</td>"
        f"<td>{escape(event.text)}</td></tr>"
        for event in events[:_EVENTS]
    ]
    more = f"<p>and {len(events) - _EVENTS} more</p>" if len(events) > _EVENTS else ""
    states = "".join(
        f'<tr><td>{state.name}</td><td class="n">{start:.3f}</td>'
        f'<td class="n">{end - start:.3f}</td></tr>'
        for state, start, end in story.bands[:_EVENTS]
    )
    beyond = len(story.bands) - _EVENTS
    further = f"<p>and {beyond} more</p>" if beyond > 0 else ""
    return (
        '<h2 id="events">Events and states</h2>\n'
        "<table><tr><th>s</th><th>tick</th><th>event</th><th>where</th><th>text</th></tr>\n"
        + "\n".join(rows)
        + f"</table>{more}\n<table><tr><th>state</th><th>from s</th><th>for s</th></tr>{states}"
        f"</table>{further}\n"
    )


def _settings(story: Story) -> str:
    log = story.log
    facts = {"file": str(log.path), "bytes": str(log.path.stat().st_size), **log.metadata}
    rows = "".join(
        f"<tr><td>{escape(key)}</td><td>{escape(value)}</td></tr>" for key, value in facts.items()
    )
    texts = "".join(
        f"<details><summary>{escape(name)}</summary><pre>{escape(_text(data))}</pre></details>\n"
        for name, data in sorted(log.attachments.items())
    )
    return f'<h2 id="settings">Settings</h2>\n<table>{rows}</table>\n{texts}'


def _text(data: bytes) -> str:
    return data.decode(errors="replace")
