"""What is broken about the robot on purpose: cables, drums, motors, sensors, and who pushes it.

Everything acts from the plant's present. What lasts is ended by the function that began it; a
defect of the same kind at the same place replaces the one before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

_SECOND_NS = 1_000_000_000
_Place = tuple[str, int]
Ender = Callable[[], None]


class _Course:
    """Something that takes time: ``act`` is told its share done in the middle and at the end of
    each stretch of time; ``done`` comes after the last."""

    def __init__(
        self,
        start_ns: int,
        seconds: float,
        act: Callable[[float, float], None],
        done: Ender = lambda: None,
    ) -> None:
        self.start_ns = start_ns
        self.span_ns = max(1, round(seconds * _SECOND_NS))
        self.end_ns = start_ns + self.span_ns
        self.act = act
        self.done = done

    def cover(self, from_ns: int, to_ns: int) -> None:
        end = (to_ns - self.start_ns) / self.span_ns
        begin = (from_ns - self.start_ns) / self.span_ns
        self.act(0.5 * (begin + end), end)


class Defects:
    """Works on a plant's state and parameters. ``axis`` counts cables and drums from 0, ``cell``
    the load cells, of which the last measures contact. Ramps take s on the plant's clock."""

    def __init__(
        self, state: NDArray[Any], parameters: NDArray[Any], present: Callable[[], int]
    ) -> None:
        self._state: Any = state[0]
        self._p: Any = parameters[0]
        self._present = present
        self.courses: dict[_Place, _Course] = {}
        """what changes with time"""
        self._coulomb = parameters["coulomb"][0].copy()
        self._torque_per_amp = parameters["torque_per_amp"][0].copy()
        self._brake_torque = parameters["brake_torque"][0].copy()
        self._gain = np.ones_like(parameters["cell_gain"][0])
        self._offset = np.zeros_like(self._gain)
        self._held = np.full_like(self._gain, np.nan)
        """N, what a frozen cell shows"""

    # -- time ------------------------------------------------------------------------------------

    def prepare(self, from_ns: int, to_ns: int) -> int:
        """Set what acts from now on; returns the time, at most ``to_ns``, up to which it does."""
        until_ns = min([to_ns, *(course.end_ns for course in self.courses.values())])
        for course in self.courses.values():
            course.cover(from_ns, until_ns)
        return until_ns

    def finish(self, now_ns: int) -> None:
        """End what has reached its end."""
        for place, course in tuple(self.courses.items()):
            if course.end_ns <= now_ns:
                del self.courses[place]
                course.done()

    def _begin(
        self,
        place: _Place,
        seconds: float,
        act: Callable[[float, float], None],
        done: Ender = lambda: None,
    ) -> None:
        self._drop(place)
        self.courses[place] = _Course(self._present(), seconds, act, done)

    def _drop(self, place: _Place) -> None:
        """End a course where it is."""
        course = self.courses.pop(place, None)
        if course is not None:
            course.done()

    def _ramp(
        self, place: _Place, over: float, old: float, new: float, set_to: Callable[[float], None]
    ) -> None:
        self._drop(place)
        if over > 0.0:
            self._begin(place, over, lambda _, end: set_to(old + end * (new - old)))
        else:
            set_to(new)

    # -- drums and motors ------------------------------------------------------------------------

    def slip_drum(self, axis: int, length: float, duration: float) -> None:
        """Let cable slip on its drum by ``length`` m, paid out where positive, within ``duration``
        s; the drum does not turn for it. Slipping out is friction, slipping in takes work."""
        rate = self._p["slip_rate"]

        def stop() -> None:
            rate[axis] = 0.0
            self._p["slipping"] = float(rate.any())

        self._begin(("slip", axis), duration, lambda *_: None, stop)
        rate[axis] = length * _SECOND_NS / self.courses["slip", axis].span_ns
        self._p["slipping"] = 1.0

    def jam_drum(self, axis: int) -> Ender:
        """Hold a drum, whatever pulls at it."""
        jammed = self._state["jammed"]
        jammed[axis] = 1

        def release() -> None:
            jammed[axis] = 0

        return release

    def rub_drum(self, axis: int, force: float, over: float = 0.0) -> Ender:
        """Add Coulomb friction of ``force`` N at the cable, growing within ``over`` s."""
        place, friction = ("friction", axis), self._p["coulomb"]
        radius, base = float(self._p["radius"][axis]), float(self._coulomb[axis])

        def set_to(added: float) -> None:
            friction[axis] = base + added * radius

        self._ramp(place, over, (float(friction[axis]) - base) / radius, force, set_to)
        return lambda: self._ramp(place, 0.0, 0.0, 0.0, set_to)

    def weaken_motor(self, axis: int, gain: float) -> Ender:
        """Leave a share of the motor's torque constant; a negative one turns it the other way."""

        def set_to(share: float) -> None:
            self._p["torque_per_amp"][axis] = share * self._torque_per_amp[axis]

        set_to(gain)
        return lambda: set_to(1.0)

    def weaken_brake(self, axis: int, gain: float) -> Ender:
        """Leave a share of the torque that the axis's holding brake holds when it is closed."""
        torque, sound = self._p["brake_torque"], float(self._brake_torque[axis])
        torque[axis] = gain * sound

        def restore() -> None:
            torque[axis] = sound

        return restore

    # -- sensors ---------------------------------------------------------------------------------

    def scale_cell(self, cell: int, gain: float, over: float = 0.0) -> Ender:
        """Have a cell show ``gain`` times the force, within ``over`` s."""
        return self._bend_cell(("cell gain", cell), self._gain, gain, over, 1.0)

    def offset_cell(self, cell: int, force: float, over: float = 0.0) -> Ender:
        """Have a cell show ``force`` N more, within ``over`` s."""
        return self._bend_cell(("cell offset", cell), self._offset, force, over, 0.0)

    def _bend_cell(
        self, place: _Place, table: NDArray[np.float64], value: float, over: float, sound: float
    ) -> Ender:
        cell = place[1]

        def set_to(new: float) -> None:
            table[cell] = new
            self._show(cell)

        self._ramp(place, over, float(table[cell]), value, set_to)
        return lambda: self._ramp(place, 0.0, 0.0, sound, set_to)

    def freeze_cell(self, cell: int) -> Ender:
        """Have a cell show for ever the force that it shows now; its noise goes on."""
        self._held[cell] = self._state["cell_force"][cell]
        self._show(cell)

        def thaw() -> None:
            self._held[cell] = np.nan
            self._show(cell)

        return thaw

    def _show(self, cell: int) -> None:
        frozen = not np.isnan(self._held[cell])
        self._p["cell_gain"][cell] = 0.0 if frozen else self._gain[cell]
        self._p["cell_offset"][cell] = self._held[cell] if frozen else self._offset[cell]

    def slip_encoder(self, axis: int, angle: float, over: float = 0.0) -> None:
        """Turn an encoder against its shaft by ``angle`` rad at the drum, for good."""
        offset, gain = self._p["encoder_offset"], self._p["encoder_gain"]
        covered = 0.0

        def act(_: float, end: float) -> None:
            nonlocal covered
            offset[axis] += gain[axis] * (end - covered) * angle
            covered = end

        self._drop(("encoder", axis))
        if over > 0.0:
            self._begin(("encoder", axis), over, act)
        else:
            act(1.0, 1.0)

    def freeze_encoder(self, axis: int) -> Ender:
        """Have an encoder count no more; what it has missed then it never counts."""
        gain, offset = self._p["encoder_gain"], self._p["encoder_offset"]
        if gain[axis] == 1.0:
            self._drop(("encoder", axis))
            offset[axis] += self._angle(axis)
            gain[axis] = 0.0

        def thaw() -> None:
            if gain[axis] == 0.0:
                offset[axis] -= self._angle(axis)
                gain[axis] = 1.0

        return thaw

    def _angle(self, axis: int) -> float:
        """rad at the drum, of the shaft that the encoder is on."""
        geared = self._p["backlash"] > 0.0
        return float(self._state["rotor_angle" if geared else "drum_angle"][axis])

    # -- from outside ----------------------------------------------------------------------------

    def hit(self, distance: float, speed: float) -> Ender:
        """Move the phantom along its normal, which is towards the contact port, by ``distance`` m
        at ``speed`` m/s; in the end it goes back as fast. Its work counts as the load's."""
        self._move_phantom(distance, speed)
        return lambda: self._move_phantom(0.0, speed)

    def _move_phantom(self, goal: float, speed: float) -> None:
        place = ("phantom", 0)
        self._drop(place)
        way = goal - float(self._state["contact_shift"])
        if way == 0.0:
            return

        def arrive() -> None:
            self._p["contact_rate"] = 0.0

        self._begin(place, abs(way) / speed, lambda *_: None, arrive)
        self._p["contact_rate"] = way * _SECOND_NS / self.courses[place].span_ns

    def push(
        self,
        force: Sequence[float],
        point: Sequence[float] = (0.0, 0.0, 0.0),
        rise: float = 0.0,
    ) -> Ender:
        """Push the platform at a point of its own frame with ``force`` N in the base frame, which
        rises and in the end falls within ``rise`` s. Its work counts as the load's."""
        place, goal = ("push", 0), np.array(force, dtype=np.float64)
        self._drop(place)
        self._p["push_point"] = point
        self._p["pushed"] = 1.0
        self._lead_push(place, np.zeros(3), goal, rise, lambda: None)

        def let_go() -> None:
            now = self._p["push_force"].copy()
            self._lead_push(place, now, np.zeros(3), rise, self._end_push)

        return let_go

    def _lead_push(
        self, place: _Place, old: Any, new: NDArray[np.float64], rise: float, done: Ender
    ) -> None:
        def act(middle: float, _: float) -> None:
            self._p["push_force"] = old + middle * (new - old)

        def arrive() -> None:
            self._p["push_force"] = new
            done()

        self.courses.pop(place, None)
        if rise > 0.0:
            self._begin(place, rise, act, arrive)
        else:
            arrive()

    def _end_push(self) -> None:
        self._p["pushed"] = 0.0
