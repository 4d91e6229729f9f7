"""Whether what a study names is there, before its first run."""

from __future__ import annotations

from difflib import get_close_matches

from tonus.config.schema.parameter_study import ParameterStudy
from tonus.runtime.control.controllers import controller_class
from tonus.runtime.errors import ControllerError
from tonus.tools.errors import ToolError
from tonus.tools.expect.names import advice, full, signals
from tonus.tools.study.indicators import INDICATORS
from tonus.tools.study.play import figures
from tonus.tools.study.provenance import firsts, loaded


def need_known(study: ParameterStudy) -> None:
    """Raises `ToolError` for a figure, a signal or a controller that there is none of, and
    `ConfigError` where the first run of a configuration, scenario and controller cannot be
    loaded."""
    known = figures(study)
    for name in (*study.shown, *(study.pareto or ())):
        if name not in known:
            near = get_close_matches(name, known, 1)
            remedy = f"did you mean {near[0]}?" if near else f"there are {', '.join(known)}"
            raise ToolError(f"study {study.name}: there is no figure {name}; {remedy}")
    for name in study.indicators:
        if name not in INDICATORS:
            remedy = f"there are {', '.join(INDICATORS)}"
            raise ToolError(f"study {study.name}: there is no indicator {name}; {remedy}")
    for name, measure in study.measures.items():
        topic = full(measure.topic)
        if measure.field not in signals().get(topic, {}):
            problem = f"study {study.name}: measures.{name}: {topic} has no field {measure.field}"
            raise ToolError(f"{problem}; {advice(topic, measure.field)}")
    for trial in firsts(study):
        config, _ = loaded(study, trial)
        try:
            controller_class(config.control.controller)
        except ControllerError as error:
            raise ToolError(f"study {study.name}: {error}") from error
