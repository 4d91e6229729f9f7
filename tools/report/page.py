"""report.html: one page that tells a run, verdict first, and needs nothing but itself."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from pathlib import Path

from matplotlib.figure import Figure

from tonus.tools.draft import write_whole
from tonus.tools.errors import ToolError
from tonus.tools.log import open as open_log
from tonus.tools.pages.page import data_url, page
from tonus.tools.pages.rows import NUMBER, Row, Rows
from tonus.tools.report import figures, panels
from tonus.tools.report.interactive import available, interactive
from tonus.tools.report.pieces import Piece, Progress
from tonus.tools.report.saved import save
from tonus.tools.report.story import Story
from tonus.tools.report.verdict import Verdict, judge
from tonus.tools.run.summary import Indicators

_BEFORE_S, _AFTER_S = 0.6, 0.4
"""s round a fault that are drawn tick by tick"""
_FAULTS = 3
"""that are drawn from near"""
_EVENTS = 500
"""rows of a table"""
_WIDE_IN = 10.0
"""from this width on a figure takes the whole page"""
_OUTLINE, _READING = 0.3, 0.8
"""shares of the work that are done when the run's states and its cycles have been read"""
_OVER_TIME = (
    *(panels.force, panels.stiffness, panels.tension, panels.error),
    *(panels.tension_error, panels.path, panels.speed),
)
_NEAR = (panels.force, panels.stiffness, panels.tension, panels.speed)


def report(file: Path, out: Path, progress: Progress) -> Verdict:
    """Write the page of a log; ``progress`` receives the share that is done.

    Raises ToolError when there is nothing to show or no place to write to.
    """
    story = Story(open_log(file), progress=lambda share: progress(_OUTLINE * share))
    content = _Content(story, lambda share: progress(_OUTLINE + (_READING - _OUTLINE) * share))
    verdict = judge(story, content.indicators)
    text = _page(story, content, verdict, progress)
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


def _page(story: Story, content: _Content, verdict: Verdict, progress: Progress) -> str:
    log = story.log
    title = f"{log.metadata.get('config', 'run')}, {log.metadata.get('scenario', log.path.name)}"
    sections, drawn = list(_sections(story, content)), []
    for number, (anchor, heading, why_not, draw) in enumerate(sections):
        figure = draw()
        drawn.append(
            {
                "anchor": anchor,
                "heading": heading,
                "why_not": why_not,
                "source": "" if figure is None else _image(figure),
                "part": figure is not None and figure.get_figwidth() < _WIDE_IN,
            }
        )
        progress(_READING + (1.0 - _READING) * (number + 1) / len(sections))
    return page(
        "report.html.j2",
        title,
        subtitle=_subtitle(story),
        verdict=verdict,
        figures=_figures(verdict),
        sections=drawn,
        interactive=interactive(story, content.sheets) if available() else "",
        events=_events(story),
        states=_states(story),
        facts=_facts(story),
        attachments=[
            (name, data.decode(errors="replace")) for name, data in sorted(log.attachments.items())
        ],
    )


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


def _figures(verdict: Verdict) -> Rows:
    rows = Rows.of(("figure", "value", "limit", "", "from", "in"), (), numbers=(1,))
    for figure in verdict.figures:
        value = "not known" if figure.value is None else f"{figure.value:.5g} {figure.unit}"
        sign = {True: "within", False: "OUTSIDE", None: ""}[figure.ok]
        texts = (figure.name, value, figure.limit, sign, figure.against, figure.window)
        cells = [(text, NUMBER if place == 1 else "") for place, text in enumerate(texts)]
        rows.lines.append(Row(cells, "out" if figure.ok is False else ""))
    return rows


def _image(figure: Figure) -> str:
    """A figure as SVG for an ``img``."""
    buffer = io.BytesIO()
    save(figure, buffer, "svg")
    return data_url(buffer.getvalue())


def _events(story: Story) -> Rows:
    events = story.log.events()
    texts = (
        (f"{story.seconds(e.time_ns):.3f}", str(e.tick), e.name, e.where, e.text)
        for e in events[:_EVENTS]
    )
    rows = Rows.of(("s", "tick", "event", "where", "text"), texts, numbers=(0, 1))
    rows.notes += [f"and {len(events) - _EVENTS} more"] if len(events) > _EVENTS else []
    return rows


def _states(story: Story) -> Rows:
    bands = story.bands
    texts = (
        (state.name, f"{start:.3f}", f"{end - start:.3f}") for state, start, end in bands[:_EVENTS]
    )
    rows = Rows.of(("state", "from s", "for s"), texts, numbers=(1, 2))
    rows.notes += [f"and {len(bands) - _EVENTS} more"] if len(bands) > _EVENTS else []
    return rows


def _facts(story: Story) -> Rows:
    path = story.log.path
    facts = {"file": str(path), "bytes": str(path.stat().st_size), **story.log.metadata}
    return Rows.of((), facts.items())
