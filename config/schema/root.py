"""One configuration: a robot, its bus, its controller, and perhaps a lab."""

from __future__ import annotations

from typing import Any

from pydantic import model_validator

from tonus.config.errors import PlacedError
from tonus.config.schema.base import Section
from tonus.config.schema.bus import Bus, check_devices
from tonus.config.schema.control import Control, Recording
from tonus.config.schema.lab import Lab
from tonus.config.schema.operation import Operation
from tonus.config.schema.place import RelaxedKey, with_defaults
from tonus.config.schema.realtime import RealTime
from tonus.config.schema.robot import Response, Robot
from tonus.config.schema.sto_relay import StoRelay
from tonus.config.schema.supervisor import LARGEST_TENSION, Supervisor
from tonus.config.schema.tolerance import Tolerance
from tonus.config.schema.tracker import Tracker


class Config(Section):
    name: str
    robot: Robot
    fieldbus: Bus
    tracker: Tracker
    tolerance: Tolerance
    control: Control
    realtime: RealTime
    recording: Recording
    operation: Operation = Operation()
    supervisor: Supervisor | None = None
    """null: none judges the daemon"""
    sto_relay: StoRelay | None = None
    """what the supervisor stops drives with that are not on CAN; null: nothing"""
    scenario: str
    """the scenario that runs when none is named"""
    lab: Lab | None = None
    relaxed: tuple[RelaxedKey, ...] = ()
    """what a configuration without a lab is to take from one (`tonus.config.schema.place`): each
    named key gets the lab's default where it is left out, and may state a value less safe than a
    robot's
    """

    @model_validator(mode="before")
    @classmethod
    def _defaults_of_the_place(cls, data: Any) -> Any:
        return with_defaults(data)

    @property
    def relay(self) -> StoRelay | None:
        """In the circuit of the STO inputs: without a supervisor it is bridged."""
        supervised = self.supervisor is not None and self.supervisor.policy != "off"
        return self.sto_relay if supervised else None

    @property
    def response(self) -> Response:
        """Of drives and cells: the lab's where there is one, else what the robot's are given as."""
        if self.lab is None:
            return self.robot.response
        plant, cell = self.lab.plant, self.lab.noise.force_cell
        return Response(current_loop_hz=plant.current_loop_hz, force_cell_hz=cell.bandwidth_hz)

    @model_validator(mode="after")
    def _numbers_fit_the_robot(self) -> Config:
        robot, tare = self.robot, self.control.sequence.tare
        try:
            check_devices(self.fieldbus, robot.cables, robot.cells)
        except PlacedError as error:
            raise PlacedError(("fieldbus", *error.path), str(error)) from error
        if tare is not None and len(tare) != robot.cells:
            raise PlacedError(
                ("control", "sequence", "tare"),
                f"states {len(tare)} offsets, the robot has {robot.cells} cells; give one for each",
            )
        return self

    @model_validator(mode="after")
    def _supervisor_fits_the_cables(self) -> Config:
        most = LARGEST_TENSION * self.control.tension.max
        if self.supervisor is not None and self.supervisor.tension_stopping > most:
            raise PlacedError(
                ("supervisor", "tension_stopping"),
                f"is more than {LARGEST_TENSION:g} times control.tension.max: no cable reaches it; "
                f"set it to at most {most:g}",
            )
        return self

    @model_validator(mode="after")
    def _tunable_has_an_effect(self) -> Config:
        if self.control.stiffness.profile == "eq10":
            return self
        for index, each in enumerate(self.operation.tunable):
            if each.key == "control.stiffness.deviation_gain":
                raise PlacedError(
                    ("operation", "tunable", index, "key"),
                    f"{each.key} has no effect with control.stiffness.profile "
                    f"{self.control.stiffness.profile}; remove it, or choose eq10",
                )
        return self

    @model_validator(mode="after")
    def _literal_stays_in_the_lab(self) -> Config:
        if self.control.controller == "eq9_literal" and self.lab is None:
            raise ValueError(
                "control.controller eq9_literal oscillates by design and needs a lab section"
            )
        return self
