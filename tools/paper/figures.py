"""Every picture of the protocol, in the order in which the page shows them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure

from tonus.tools.paper import charts, curves
from tonus.tools.paper.results import Results


@dataclass(frozen=True)
class Picture:
    """``name`` of its file."""

    name: str
    heading: str
    caption: str
    draw: Callable[[Results], Figure | None]


PICTURES: tuple[Picture, ...] = (
    Picture(
        "table3_bars",
        "Table 3 relative to PID",
        "Bars: means in the lab, with the standard deviation over seeds; PID is 1.",
        charts.table3_bars,
    ),
    Picture(
        "pareto",
        "Soft on contact against firm under load",
        "Down and left is better. Filled: with the envelope; open: without it.",
        charts.pareto,
    ),
    Picture(
        "slope",
        "Stage 1: force against way at constant tension",
        "The platform is moved by the load port; its tensions are frozen.",
        curves.force_against_way,
    ),
    Picture(
        "tracking",
        "Stage 2: the fastest sine",
        "Seed 1 in the lab; errors against the plant's truth, start-up included.",
        curves.tracking,
    ),
    Picture(
        "accuracy",
        "Stage 2: RMS error of every sine",
        "Mean over seeds, lab, against truth.",
        charts.accuracy_map,
    ),
    Picture("ramp", "Stage 3: 100 N at 20 N/s", "Seed 1 in the lab.", curves.load_ramp),
    Picture("step", "Stage 3: 25 N at once", "Seed 1 in the lab.", curves.load_step),
    Picture("contact", "Stage 3: unexpected contact", "Seed 1 in the lab.", curves.contact),
    Picture("press", "Stage 3: a force on the phantom", "Seed 1 in the lab.", curves.pressing),
    Picture(
        "plants",
        "Drawn plants",
        "EA, anchors, mass, friction and tracker latency differ from the controller's model.",
        charts.drawn_plants,
    ),
    Picture(
        "eq9",
        "Eq. (9) as printed",
        "Proportional tension control with the gain that half a per cent needs.",
        curves.literal,
    ),
)
