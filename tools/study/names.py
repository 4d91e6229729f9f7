"""Whether what a study names is there, and each of its values one that can be set, before its first
run."""

from __future__ import annotations

from dataclasses import replace
from difflib import get_close_matches

from tonus.config.errors import ConfigError
from tonus.config.schema.parameter_study import ParameterStudy
from tonus.runtime.control.controllers import controller_class
from tonus.runtime.errors import ControllerError
from tonus.tools.errors import ToolError
from tonus.tools.expect.names import advice, full, signals
from tonus.tools.study.indicators import INDICATORS
from tonus.tools.study.play import figures
from tonus.tools.study.provenance import firsts, loaded
from tonus.tools.study.trials import Trial, bounds, trials


def need_known(study: ParameterStudy) -> None:
    """Raises `ToolError` for a figure, a signal or a controller that there is none of, and for a
    value of a parameter that its key does not take; `ConfigError` where the first run of a
    configuration, scenario and controller cannot be loaded."""
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
    planned = trials(study)
    for path in study.configs:
        _need_possible(study, next(each for each in planned if each.config == path))
    for trial in firsts(study):
        config, _ = loaded(study, trial)
        try:
            controller_class(config.control.controller)
        except ControllerError as error:
            raise ToolError(f"study {study.name}: {error}") from error


def _need_possible(study: ParameterStudy, trial: Trial) -> None:
    """Raises `ToolError` for a value that its own key does not take. What it may be beside other
    values is the matter of each run."""
    for key, parameter in study.parameters.items():
        for value in bounds(parameter):
            parameters = trial.parameters | {key: value}
            try:
                loaded(study, replace(trial, parameters=parameters))
            except ConfigError as error:
                if error.key != key and not error.key.startswith(f"{key}."):
                    continue
                place = f"study {study.name}: parameters.{key}"
                raise ToolError(f"{place}: {error.problem}; {error.remedy}") from error
