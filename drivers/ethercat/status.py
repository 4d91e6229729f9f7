"""The state and the clock of every slave, asked for in one frame that nobody waits for."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass

from tonus.drivers.ethercat import al
from tonus.drivers.ethercat.al import ERROR, AlState
from tonus.drivers.ethercat.frames import MAXIMUM_DATA, Command, Datagram, build, parse, station
from tonus.drivers.ethercat.port import OURS, FramePort

AL_CONTROL = 0x0120
_AL_STATUS = 0x0130
_DIFFERENCE = 0x092C
_STATUS = struct.Struct("<HHH")  # 0x0130, reserved, 0x0134
_STATUS_INDEX, _CONTROL_INDEX = OURS, OURS + 1
_SIGN = 1 << 31
_QUESTIONS = 2
"""Datagrams for a slave."""
_BYTES = _QUESTIONS * 12 + _STATUS.size + 4
"""Of one slave in a frame, headers included."""
MOST = MAXIMUM_DATA // _BYTES
"""Slaves that one frame can ask."""


@dataclass(frozen=True)
class SlaveStatus:
    """What a slave says in 0x0130, 0x0134 and 0x092C."""

    state: int
    """without the error bit; a broken slave's may be no `AlState`"""
    error: bool
    code: int
    difference_ns: int = 0
    """of its clock from the reference"""

    @property
    def operational(self) -> bool:
        return self.state == AlState.OP and not self.error

    def __str__(self) -> str:
        text = al.name(self.state)
        if self.error:
            text += " + ERROR"
        if self.code:
            text += f" (AL status 0x{self.code:04X}: {al.words(self.code)})"
        return text


class StatusFrames:
    """Asks all slaves of a segment at once, and writes AL control, through a port."""

    def __init__(self, port: FramePort, stations: list[int]) -> None:
        self._port = port
        self._stations = stations
        self._question: list[Datagram] = []
        self.open_after: int | None = None
        """slaves on the near side of an open ring, as the last answer had it; None: closed, or a
        line"""
        for address in stations:
            ask = Datagram(Command.FPRD, station(address, _AL_STATUS), bytes(_STATUS.size))
            self._question.append(ask)
            ask = Datagram(Command.FPRD, station(address, _DIFFERENCE), bytes(4))
            self._question.append(ask)
        self._frame = build(_STATUS_INDEX, self._question)

    def look(self) -> None:
        while self._port.receive() is not None:
            pass  # answers to AL control, or a late one
        self._port.send(self._frame)

    def looked(self) -> list[SlaveStatus | None] | None:
        """None: no answer (yet). Within it None: a slave that took no part."""
        while (frame := self._port.receive()) is not None:
            answers = parse(frame, _STATUS_INDEX, self._question)
            if answers is not None:
                break
        else:
            return None
        turned = self._port.turned
        self.open_after = None if turned is None else turned // _QUESTIONS
        found: list[SlaveStatus | None] = []
        for status, difference in zip(answers[::_QUESTIONS], answers[1::_QUESTIONS], strict=True):
            if not status.counter:
                found.append(None)
                continue
            state, _, code = _STATUS.unpack(status.data)
            away = int.from_bytes(difference.data, "little")
            ns = -(away & ~_SIGN) if away & _SIGN else away
            found.append(SlaveStatus(state & 0xF, bool(state & ERROR), code, ns))
        return found

    def control(self, words: Mapping[int, int]) -> None:
        orders = []
        for slave, word in words.items():
            address = station(self._stations[slave], AL_CONTROL)
            orders.append(Datagram(Command.FPWR, address, word.to_bytes(2, "little")))
        if orders:
            self._port.send(build(_CONTROL_INDEX, orders))


class StateAccess:
    """The part of a `tonus.drivers.ethercat.wire.Wire` that asks for states and sets them, once it
    is known of whom."""

    def __init__(self) -> None:
        self.states: StatusFrames | None = None

    def look(self) -> None:
        if self.states is not None:
            self.states.look()

    def looked(self) -> list[SlaveStatus | None] | None:
        return self.states.looked() if self.states is not None else None

    @property
    def open_after(self) -> int | None:
        return self.states.open_after if self.states is not None else None

    def control(self, words: Mapping[int, int]) -> None:
        if self.states is not None:
            self.states.control(words)
