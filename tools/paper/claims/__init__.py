"""Every claim of the paper that can be put to the test, and what our data say about it.

A verdict comes from figures by a rule of `verdicts`; a sentence explains it and decides nothing.
"""

from tonus.tools.paper.claims.agreement import agreement, superiority
from tonus.tools.paper.claims.response import accuracy, dynamics, stiffness
from tonus.tools.paper.claims.safety import inner_loop, safety, stability
from tonus.tools.paper.compare import Match
from tonus.tools.paper.results import Results
from tonus.tools.paper.verdicts import Claim

__all__ = ["claims"]


def claims(results: Results, matches: list[Match]) -> list[Claim]:
    """All claims, about in the order of the paper's abstract, sections and tables."""
    return [
        *accuracy(results),
        *dynamics(results),
        *stiffness(results),
        *inner_loop(results),
        *safety(results),
        *agreement(results, matches),
        *superiority(results),
        *stability(results),
    ]
