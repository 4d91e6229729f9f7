"""The outcome of `tonus verify` for a CI server, in the JUnit format."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from tonus.tools.draft import write_whole
from tonus.tools.verify.play import Judged


def write(path: Path, judged: Sequence[Judged]) -> None:
    """A suite of one case for each scenario."""
    suite = Element(
        "testsuite",
        name="tonus verify",
        tests=str(len(judged)),
        failures=str(sum(each.failed for each in judged)),
        errors=str(sum(bool(each.refused) for each in judged)),
        time=f"{sum(each.seconds for each in judged):.3f}",
    )
    for each in judged:
        case = SubElement(
            suite, "testcase", classname="tonus.verify", name=each.name, time=f"{each.seconds:.3f}"
        )
        if each.refused:
            SubElement(case, "error", message=each.refused)
        missed = [f"{one.expected}: {one.problem}" for one in each.verdicts if one.problem]
        if missed:
            SubElement(case, "failure", message=missed[0]).text = "\n".join(missed)
    indent(suite)
    write_whole(path, tostring(suite, encoding="unicode", xml_declaration=True) + "\n")
