"""From YAML files to a checked configuration and scenario."""

from __future__ import annotations

import reprlib
from pathlib import Path
from typing import Any

from tonus.config.checked import Model, choose, validated
from tonus.config.document import (
    IS_DEVICE,
    IS_DIRECTORY,
    Document,
    Key,
    dotted,
    is_file,
    no_file,
    read,
)
from tonus.config.errors import ConfigError
from tonus.config.parts import SCENARIO, part_of
from tonus.config.relaxed import unnamed_risks
from tonus.config.schema.bounds import Bounds
from tonus.config.schema.budget import Budget
from tonus.config.schema.campaign import Study
from tonus.config.schema.least_stop import LeastStops
from tonus.config.schema.parameter_study import ParameterStudy
from tonus.config.schema.plausible import Plausible
from tonus.config.schema.protocol import Protocol
from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.config.schema.trajectory import Prepared
from tonus.config.schema.tuning import Tuning

HERE = Path(__file__).resolve().parent
"""The folder of the shipped files itself, whichever link this module was imported through."""
Overrides = dict[str, Any]


def load(
    path: str | Path, scenario: str | None = None, overrides: Overrides | None = None
) -> tuple[Config, Scenario]:
    """Read a configuration and the scenario it names, or the one named here.

    ``path`` may also be the name of a shipped configuration, and ``scenario`` a path to a YAML
    file. Relative paths in a file start from that file's folder, those given here from the working
    directory. ``overrides`` maps dotted keys
    ("control.controller") to values, for tests and command-line options. Raises `ConfigError`.
    """
    document = _configuration(path)
    _overridden(document, overrides)
    config = validated(document, Config)
    for path_of, problem, remedy in unnamed_risks(config):
        raise ConfigError(*document.place(path_of), dotted(path_of), problem, remedy)
    if scenario is not None:
        return config, load_scenario(scenario)
    at: Key = ("scenario",)
    base = document.folder(at)
    return config, _scenario(config.scenario, *document.place(at), "scenario", base=base)


def load_catalogue(path: str | Path) -> list[Scenario]:
    """Every scenario that a configuration lets an operator choose from. Raises `ConfigError`."""
    document = _configuration(path)
    names = validated(document, Config).operation.scenarios
    if names is None:
        return [load_scenario(name) for name in scenario_names()]
    found = []
    for index, name in enumerate(names):
        key: Key = ("operation", "scenarios", index)
        place = document.place(key)
        found.append(_scenario(name, *place, dotted(key), base=document.folder(key)))
    return found


def _configuration(path: str | Path) -> Document:
    """A configuration's document. Under ``set`` it may give values of its own, by dotted keys, to
    what it includes. Raises `ConfigError`."""
    file, shown = locate(path)
    document = read(file, shown)
    part = part_of(document.data)
    if part is not None:
        problem = f"is no whole configuration but its part {part}"
        remedy = f"name the file that has {part.split('.')[-1]}: !include {file.name}"
        if part == SCENARIO:
            problem, remedy = "is a scenario", "name a configuration, and this with --scenario"
        raise ConfigError(shown, 0, "", problem, remedy)
    changes = document.data.pop("set", {}) if isinstance(document.data, dict) else {}
    if not isinstance(changes, dict):
        problem = "is no mapping"
        raise ConfigError(*document.place(("set",)), "set", problem, "write key: value below it")
    for key, value in changes.items():
        path_of = _override(document, key, value, *document.place(("set", key)))
        document.places[path_of] = document.place(("set", key))
    return document


def load_plausible() -> Plausible:
    """Bounds of values in their units, config/plausible.yaml."""
    return validated(read(HERE / "plausible.yaml", "config/plausible.yaml"), Plausible)


def load_tuning(path: str | Path | None = None) -> Tuning:
    """What `tonus tune` goes by: config/tuning.yaml, or a file like it. Raises `ConfigError`."""
    if path is None:
        return validated(read(HERE / "tuning.yaml", "config/tuning.yaml"), Tuning)
    return validated(read(Path(path)), Tuning)


def load_scenario(name: str, overrides: Overrides | None = None) -> Scenario:
    """A scenario by the name of a file in config/scenarios, or by a path to one."""
    return _scenario(name, f"scenario {name}", 0, "", overrides)


def load_budget(name: str) -> Budget:
    """A timing budget by the name of a file in config/budgets, or by a path to one."""
    return validated(_named("budget", name, f"budget {name}", 0, ""), Budget)


def _named(kind: str, name: str, file: str, line: int, key: str, base: Path = Path()) -> Document:
    """One of the files in config/<kind>s, or any by its path, with or without its suffix; a
    relative one starts from ``base``. ``file``, ``line`` and ``key`` are where the name stands."""
    folder = HERE / f"{kind}s"
    path, shown = base / name, str(base / name)
    if path.suffix not in (".yaml", ".yml"):
        ours = folder / f"{name}.yaml"
        written = path.with_name(f"{path.name}.yaml") if path.name else path
        if Path(name).name == name and is_file(ours):
            path, shown = ours, f"config/{folder.name}/{ours.name}"
        elif not is_file(path):
            path, shown = written, str(written)
    if not is_file(path):
        known = sorted(ours.stem for ours in folder.glob("*.yaml"))
        # The suffix, or a folder, says that a file was meant, and not a shipped one's name.
        of_file = Path(name).suffix or Path(name).name != name
        problem = f"there is no {'file' if of_file else kind} {reprlib.repr(name)}"
        if of_file and no_file(base / name) in (IS_DIRECTORY, IS_DEVICE):
            problem = f"{reprlib.repr(name)} {no_file(base / name)}"
        raise ConfigError(file, line, key, problem, choose(path.stem, known))
    return read(path, shown)


def load_bounds() -> Bounds:
    """What a run in the lab has to keep, config/bounds.yaml."""
    return validated(read(HERE / "bounds.yaml", "config/bounds.yaml"), Bounds)


def load_section(path: Path, model: type[Model]) -> Model:
    """Any YAML file by its schema. Raises `ConfigError`."""
    return validated(read(path, str(path)), model)


def load_parameter_study(path: str | Path) -> ParameterStudy:
    """A study of parameters by its file, or by the name of one in config/campaigns; its relative
    files start from its own folder. Raises `ConfigError`."""
    document = _named("campaign", str(path), f"study {path}", 0, "")
    study = validated(document, ParameterStudy)
    files = {
        key: tuple(_beside(document.folder((key,)), each) for each in getattr(study, key))
        for key in ("configs", "scenarios")
    }
    return study.model_copy(update=files)


def _beside(folder: Path, name: str) -> str:
    """A file in ``folder``, or the name as it is."""
    return str(folder / name) if is_file(folder / name) else name


def load_study(name: str) -> Study:
    """A study by the name of a file in config/campaigns, or by a path to one."""
    return validated(_named("campaign", name, f"study {name}", 0, ""), Study)


def load_protocol() -> Protocol:
    """The paper's test programme, config/protocol.yaml."""
    return validated(read(HERE / "protocol.yaml", "config/protocol.yaml"), Protocol)


def load_least_stops() -> LeastStops:
    """What physics allows after a torn cable, config/least_stop.yaml."""
    return validated(read(HERE / "least_stop.yaml", "config/least_stop.yaml"), LeastStops)


def scenario_names() -> list[str]:
    """Every scenario that comes with the package."""
    return sorted(ours.stem for ours in (HERE / "scenarios").glob("*.yaml"))


def _scenario(
    name: str,
    file: str,
    line: int,
    key: str,
    overrides: Overrides | None = None,
    base: Path = Path(),
) -> Scenario:
    document = _named("scenario", name, file, line, key, base)
    _overridden(document, overrides)
    return _prepared(document, validated(document, Scenario))


def _prepared(document: Document, scenario: Scenario) -> Scenario:
    """With its reference computed, read or sampled, where that has to be done before the tick."""
    reference = scenario.reference
    if not isinstance(reference, Prepared) or reference.prepared is not None:
        return scenario
    # Only where one is computed: they take scipy, which takes a second to load.
    from tonus.config.trajectories import prepare
    from tonus.config.trajectories.samples import TrajectoryError

    try:
        samples = prepare(reference, document.folder(("reference",)))
    except TrajectoryError as error:
        key: Key = ("reference", error.key)
        place = document.place(key)
        raise ConfigError(*place, dotted(key), error.problem, error.remedy) from error
    played = reference.model_copy(update={"prepared": samples})
    return scenario.model_copy(update={"reference": played})


def locate(name: str | Path) -> tuple[Path, str]:
    """Where a configuration is, and its name to people: a file as given; otherwise one of ours, so
    that an installed wheel needs no checkout. Raises `ConfigError`."""
    path = Path(name)
    if is_file(path):
        return path, str(path)
    ours = HERE / path.name
    named = path.parent in (Path(), Path("config"))
    if named and is_file(ours):
        return ours, f"config/{path.name}"
    known = sorted(file.stem for file in HERE.glob("*.yaml") if _complete(file))
    remedy = choose(path.stem, known, shown="config/{}.yaml")
    problem = no_file(path)
    if problem == IS_DIRECTORY:
        within = sorted(str(file) for file in path.glob("*.yaml") if _complete(file))
        remedy = f"name one of {', '.join(within)}" if within else remedy
    raise ConfigError(str(path), 0, "", problem, remedy)


def _complete(file: Path) -> bool:
    """Whether it is a whole configuration, and not a part that others include."""
    return "\nfieldbus:" in file.read_text(encoding="utf-8", errors="replace")


def _overridden(document: Document, overrides: Overrides | None) -> None:
    """Set values that stand in no file: what is wrong with one is its own mistake."""
    for key, value in (overrides or {}).items():
        document.places[_override(document, key, value)] = ("overrides", 0)


def _override(
    document: Document, key: str, value: Any, stated: str = "", stated_line: int = 0
) -> Key:
    """Set one value; what is not there to hold it is an error at that place, or where the change is
    ``stated`` (a file and a line)."""
    *parents, last = key.split(".")
    place = document.data
    path: Key = ()
    for part in parents:
        step = int(part) if isinstance(place, list) and part.isdecimal() else part
        path = (*path, step)
        try:
            place = place[step]
        except (KeyError, IndexError, TypeError) as error:
            file, line = (stated, stated_line) if stated else document.place(path)
            problem = f"is not there, so {key} cannot be set"
            names = list(place) if isinstance(place, dict) else []
            remedy = choose(part, names, "add it")
            raise ConfigError(file, line, dotted(path), problem, remedy) from error
    if isinstance(place, dict):
        place[last] = value
        return (*path, last)
    if isinstance(place, list) and last.isdecimal() and int(last) < len(place):
        place[int(last)] = value
        return (*path, int(last))
    file, line = (stated, stated_line) if stated else document.place(path)
    raise ConfigError(file, line, key, "is not there and cannot be set", "correct its spelling")
