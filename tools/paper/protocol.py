"""The paper's three stages as cases, and the trials a campaign makes of them."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil
from typing import Any

import numpy as np

from tonus.config.schema.base import Direction
from tonus.config.schema.protocol import Jump, Protocol, Selection, SineSet
from tonus.config.schema.root import Config
from tonus.config.schema.scenario import Scenario
from tonus.tools.errors import ToolError
from tonus.tools.paper.case import Case, Kind, Run
from tonus.tools.run.parting import lead_in

CONSTANT_TENSION = "constant_tension"
LITERAL = "eq9_literal"
OPEN_LITERAL = "eq9_no_envelope"
OPEN_CONTACT = "contact_no_envelope"
_ENVELOPE_OFF = (("control.envelope.enabled", False),)
Plain = dict[str, Any]
_HOLD: Plain = {"kind": "hold"}
_ALONG: Direction = (1.0, 0.0, 0.0)
_UP: Direction = (0.0, 0.0, 1.0)
_MM = 1e3


class Programme:
    """Builds the cases for a robot."""

    def __init__(self, protocol: Protocol, config: Config) -> None:
        self._protocol = protocol
        self._home = np.array(config.robot.home)
        self._begin = lead_in(config)
        self._slew = 1.0 / config.control.sequence.reference_slew

    def cases(self) -> list[Case]:
        """Every one, in the order of the stages."""
        return [self.slope(1), *self._sines(), *self._moves(), *self._loads(), *self._contacts()]

    def drawn(self) -> Case:
        """The short test of a drawn plant."""
        test = self._protocol.drawn_test
        duration = test.fade + test.periods / test.frequency
        sine = _sine(test.direction, test.amplitude, test.frequency, test.fade)
        script = {"load": self._jump(test.load, self._protocol.lead, _ALONG)}
        text = "A sine, and a load that comes and goes while it fades in"
        return self._case(0, "drawn", Kind.SINE, text, duration, sine, script)

    def slope(self, cycles: int) -> Case:
        """Stage 1, so many cycles in one run."""
        slope = self._protocol.slope
        there = slope.distance / slope.speed
        begin = self._begin + slope.wait
        profile = [{"at": begin, "distance": 0.0}]
        for cycle in range(cycles):
            start = begin + 2.0 * there * cycle
            profile.append({"at": start + there, "distance": slope.distance})
            profile.append({"at": start + 2.0 * there, "distance": 0.0})
        script = {
            "displacement": {
                "direction": _UP,
                "stiffness": slope.grip_stiffness,
                "damping": slope.grip_damping,
                "profile": profile,
            },
            "phantom": self._phantom(_UP, -slope.pressed),
        }
        text = f"{_MM * slope.distance:g} mm against the phantom at constant tension"
        duration = slope.wait + 2.0 * there * cycles
        return self._case(1, "slope", Kind.SLOPE, text, duration, _HOLD, script)

    def _sines(self) -> Iterator[Case]:
        for axis, direction in self._protocol.directions.items():
            for one in self._protocol.sines.sets:
                yield from self._sine_set(axis, direction, one)

    def _sine_set(self, axis: str, direction: Direction, one: SineSet) -> Iterator[Case]:
        sines = self._protocol.sines
        for amplitude in one.amplitudes:
            for frequency in one.frequencies:
                periods = max(sines.periods, ceil(sines.least * frequency))
                name = f"sine_{axis}_{_MM * amplitude:g}mm_{frequency:g}Hz"
                text = f"{_MM * amplitude:g} mm at {frequency:g} Hz along {axis}"
                duration = sines.fade + periods / frequency
                reference = _sine(direction, amplitude, frequency, sines.fade)
                yield self._case(2, name, Kind.SINE, text, duration, reference)

    def _moves(self) -> Iterator[Case]:
        steps = self._protocol.steps
        still = self._protocol.still
        yield self._case(2, "hold", Kind.HOLD, "Nothing but holding still", still, _HOLD)
        for axis, direction in self._protocol.directions.items():
            there = np.array(direction) / np.linalg.norm(direction) * steps.distance
            waypoints = [
                {"position": point, "duration": steps.duration, "pause": steps.pause}
                for point in (tuple(there.tolist()), (0.0, 0.0, 0.0))
            ]
            name = f"move_{axis}_{_MM * steps.distance:g}mm"
            text = f"Minimum-jerk steps of {_MM * steps.distance:g} mm along {axis}"
            duration = 2.0 * (steps.duration + steps.pause)
            reference = {"kind": "path", "waypoints": waypoints}
            yield self._case(2, name, Kind.MOVE, text, duration, reference)

    def _loads(self) -> Iterator[Case]:
        ramp, jump, lead = self._protocol.ramp, self._protocol.jump, self._protocol.lead
        rise = ramp.force / ramp.rate
        begin = self._begin + lead
        for axis, direction in self._protocol.directions.items():
            profile = [
                {"at": begin, "force": 0.0},
                {"at": begin + rise, "force": ramp.force},
            ]
            load = {"direction": direction, "point": (0.0, 0.0, 0.0), "profile": profile}
            text = f"A load along {axis} that rises at {ramp.rate:g} N/s to {ramp.force:g} N"
            duration = lead + rise + ramp.hold
            yield self._case(3, f"ramp_{axis}", Kind.RAMP, text, duration, _HOLD, {"load": load})
        for axis, direction in self._protocol.directions.items():
            text = f"A load of {jump.force:g} N along {axis}, at once"
            script = {"load": self._jump(jump, lead, direction, stays=True)}
            yield self._case(3, f"step_{axis}", Kind.STEP, text, lead + jump.hold, _HOLD, script)

    def _jump(
        self,
        jump: Jump,
        lead: float,
        direction: Direction,
        *,
        stays: bool = False,
    ) -> Plain:
        begin = self._begin + lead
        profile = [
            {"at": begin, "force": 0.0},
            {"at": begin + jump.rise, "force": jump.force},
        ]
        if not stays:
            end = begin + jump.hold
            profile.append({"at": end, "force": jump.force})
            profile.append({"at": end + jump.rise, "force": 0.0})
        return {"direction": direction, "point": (0.0, 0.0, 0.0), "profile": profile}

    def _contacts(self) -> Iterator[Case]:
        contact, press = self._protocol.contact, self._protocol.press
        reference: Plain = {
            "kind": "path",
            "waypoints": [
                {
                    "position": (-contact.back, 0.0, 0.0),
                    "duration": contact.approach,
                    "pause": contact.settle,
                },
                {
                    "position": (contact.gap + contact.distance, 0.0, 0.0),
                    "duration": contact.duration,
                    "pause": contact.pause,
                },
            ],
        }
        duration = contact.approach + contact.settle + contact.duration + contact.pause
        script = {"phantom": self._phantom(_ALONG, contact.gap)}
        text = "A move whose way is blocked by the phantom"
        yield self._case(3, "contact", Kind.CONTACT, text, duration, reference, script)
        text += ", with the safety envelope switched off"
        yield self._case(
            3, OPEN_CONTACT, Kind.CONTACT, text, duration, reference, script, _ENVELOPE_OFF
        )
        reference = {
            "kind": "press",
            "direction": _ALONG,
            "distance": press.distance,
            "approach": press.approach,
            "fade": press.fade,
            "force": press.force,
            "swing": press.swing,
            "frequency": press.frequency,
            "stiffness": self._protocol.body.stiffness,
        }
        duration = press.approach + press.fade + press.periods / press.frequency
        script = {"phantom": self._phantom(_ALONG, press.distance)}
        text = f"{press.force:g} N with a swing of {press.swing:g} N on the phantom"
        yield self._case(3, "press", Kind.PRESS, text, duration, reference, script)
        text = "The loop of eq. (9) as printed, holding still"
        still = self._protocol.literal
        yield self._case(3, LITERAL, Kind.HOLD, text, still, _HOLD)
        text += ", with the safety envelope switched off"
        yield self._case(3, OPEN_LITERAL, Kind.HOLD, text, still, _HOLD, overrides=_ENVELOPE_OFF)

    def _phantom(self, way: Direction, distance: float) -> Plain:
        """A body ``distance`` m from home along ``way``, a unit vector."""
        point = self._home + distance * np.array(way)
        normal = -np.array(way)
        place = {"point": tuple(point.tolist()), "normal": tuple(normal.tolist())}
        return self._protocol.body.model_dump() | place

    def _case(
        self,
        stage: int,
        name: str,
        kind: Kind,
        text: str,
        duration: float,
        reference: Plain,
        script: Plain | None = None,
        overrides: tuple[tuple[str, object], ...] = (),
    ) -> Case:
        # A reference is brought up to its pace at the start, and so ends a little later.
        scenario = {
            "name": name,
            "description": f"{text}.",
            "duration": duration + self._slew,
            "reference": reference,
            "lab": script or {},
        }
        return Case(stage, name, kind, Scenario.model_validate(scenario), overrides)


def _sine(direction: Direction, amplitude: float, frequency: float, fade: float) -> Plain:
    return {
        "kind": "sine",
        "direction": direction,
        "amplitude": amplitude,
        "frequency": frequency,
        "fade": fade,
    }


def runs(
    protocol: Protocol, config: Config, selection: Selection, stages: frozenset[int]
) -> list[Run]:
    """Every trial of a campaign, each key once. Raises `ToolError` for a case that is none."""
    programme = Programme(protocol, config)
    cases = _chosen(programme.cases(), selection)
    seeds = range(1, selection.repetitions + 1)
    found: list[Run] = []
    for case in cases:
        if case.stage not in stages:
            continue
        if case.kind is Kind.SLOPE:
            # No chance in the model: its cycles are one run. In the lab every cycle is one.
            cycles = programme.slope(selection.slope_cycles)
            found += [Run(cycles, CONSTANT_TENSION, "model", 1, "direct")]
            found += [Run(case, CONSTANT_TENSION, "lab", seed, "direct") for seed in seeds]
        elif case.name in (LITERAL, OPEN_LITERAL):
            # Where nothing starts it, an unstable loop rests.
            found += [Run(case, LITERAL, "lab", 1, "direct")]
        else:
            for controller in selection.controllers:
                if controller in protocol.contact_only and case.kind not in _TOUCHING:
                    continue
                found += [Run(case, controller, "model", 1, "direct")]
                if case.name != OPEN_CONTACT:
                    found += [Run(case, controller, "lab", seed, "direct") for seed in seeds]
                if case.name in selection.sample and controller in selection.sample_controllers:
                    found += [Run(case, controller, "lab", 1, "can")]
    if 3 in stages:
        found += plant_runs(protocol, config, selection.drawn)
    return found


_TOUCHING = frozenset({Kind.CONTACT, Kind.PRESS})


def plant_runs(protocol: Protocol, config: Config, count: int) -> list[Run]:
    """The short test once on each of so many drawn plants; plant-017 is drawn with seed 17."""
    case = Programme(protocol, config).drawn()
    return [Run(case, "bio", f"plant-{seed:03d}", seed, "direct") for seed in range(1, count + 1)]


def _chosen(cases: list[Case], selection: Selection) -> list[Case]:
    if selection.cases is None:
        return cases
    known = {case.name for case in cases}
    for name in selection.cases:
        if name not in known:
            raise ToolError(
                f"config/protocol.yaml: quick.cases: there is no case {name}; "
                f"choose of {', '.join(sorted(known))}"
            )
    return [case for case in cases if case.name in selection.cases]


def robot_seconds(config: Config, run: Run) -> float:
    """About how long a trial takes in robot time: taring, bring-up and ACTIVE."""
    return config.control.sequence.tare_s + lead_in(config) + run.case.scenario.duration
