"""The keys of the files in docs/safety. Each file may have any of the sections; all are one."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from tonus.config.schema.base import Section
from tonus.runtime.states import State

Text = Annotated[str, Field(min_length=1)]
Tests = dict[str, tuple[Text, ...]]
"""names of tests by the name of their file"""
HazardId = Annotated[str, Field(pattern=r"^HAZ-\d+$")]
SituationId = Annotated[str, Field(pattern=r"^SIT-\d+$")]
ControlId = Annotated[str, Field(pattern=r"^RC-\d+$")]
RequirementId = Annotated[str, Field(pattern=r"^[A-Z]{3}-\d+$")]
FailureId = Annotated[str, Field(pattern=r"^FM-\d+$")]


class Hazard(Section):
    hazard: Text
    harm: Text
    situations: Annotated[dict[SituationId, Text], Field(min_length=1)]
    """hazardous situations"""
    controls: tuple[ControlId, ...]
    residual: Text
    """risk that remains with the controls"""


class Control(Section):
    control: Text
    kind: Literal["design", "protective", "information"]
    """inherently safe design, protective measure, or information for the user"""
    requirements: tuple[RequirementId, ...]


class Requirement(Section):
    text: Text
    tests: Tests


class Failure(Section):
    """One row of the FMEA: a single failure of one part."""

    id: FailureId
    failure: Text
    effect: Text
    noticed: Text
    """what detects it; events and faults in backticks"""
    reaction: Text
    state: str
    """the state that follows, or `unchanged`"""
    within: str | None = None
    """the time of the reaction: keys of the configuration and whole ticks, added"""
    when: str | None = None
    """in place of ``within``, where no budget bounds it: words without a figure"""
    leads_to: Annotated[tuple[SituationId, ...], Field(min_length=1)]
    requirements: Annotated[tuple[RequirementId, ...], Field(min_length=1)]
    residual: Text
    tests: Tests = Field(default_factory=dict)
    open: str | None = None
    """why no test shows it"""

    @model_validator(mode="after")
    def _whole(self) -> Failure:
        if (self.within is None) == (self.when is None):
            raise ValueError(f"{self.id} needs either within or when")
        if self.when is not None and any(letter.isdigit() for letter in self.when):
            raise ValueError(f"{self.id}: a figure in when; name its key with within")
        if bool(self.tests) == (self.open is not None):
            raise ValueError(f"{self.id} needs either tests or, in open, why there is none")
        if self.state != "unchanged" and self.state not in State.__members__:
            raise ValueError(f"{self.id}: there is no state {self.state!r}")
        return self


class SafetyPath(Section):
    files: tuple[Text, ...]
    """files of which every test belongs to a requirement"""


class Part(Section):
    """One file of docs/safety."""

    hazards: dict[HazardId, Hazard] = Field(default_factory=dict)
    controls: dict[ControlId, Control] = Field(default_factory=dict)
    requirements: dict[RequirementId, Requirement] = Field(default_factory=dict)
    failures: dict[Text, tuple[Failure, ...]] = Field(default_factory=dict)
    """by the part that fails"""
    safety_path: SafetyPath = SafetyPath(files=())
