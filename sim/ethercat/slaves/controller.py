"""A slave controller: its registers, sync managers, FMMUs, EEPROM interface and process memory.

The controller knows no states and no device; what the firmware behind it has to hear of, it tells
through `Firmware`.
"""

from __future__ import annotations

import struct
from typing import NamedTuple, Protocol

from tonus.sim.ethercat.slaves import registers as reg
from tonus.sim.ethercat.slaves.eeprom import Eeprom

_BUFFERED, _MAILBOX = 0, 2
FULL = 0x08
_ENABLE = 0x01
_REPEAT = 0x02
_LOCKED = 0x01
_WATCHDOG_TRIGGER = 0x40
_ALIAS_USED = 0x01
_WORD = struct.Struct("<H")
_BLOCK = struct.Struct("<HHBBBB")
_FMMU = struct.Struct("<IHBBHBBB")
READ, WRITE = 1, 2


class Firmware(Protocol):
    """What the slave behind a controller is told, with the time in ns."""

    def control(self, word: int, now_ns: int) -> None:
        """The AL control register was written."""

    def mailbox_written(self, data: bytes, now_ns: int) -> None: ...

    def mailbox_read(self, now_ns: int) -> None:
        """The send mailbox has been emptied."""

    def repeat(self, now_ns: int) -> None:
        """The master wants the last message of the send mailbox again."""

    def outputs_written(self, now_ns: int) -> None:
        """The last byte of the output area was written."""

    def inputs_read(self, now_ns: int) -> None: ...

    def remapped(self) -> None:
        """Station address, FMMUs or sync managers are not what they were."""

    def watchdog_set(self, now_ns: int) -> None:
        """The watchdog's time may be another."""

    def clock_read(self, now_ns: int) -> None:
        """Registers of time are about to be read."""

    def clock_written(self, start: int, data: bytes, now_ns: int) -> None: ...


class Manager:
    """A sync manager as its registers have it."""

    __slots__ = ("control", "enabled", "length", "locked", "number", "open", "start")

    def __init__(self, number: int) -> None:
        self.number = number
        self.start = self.length = self.control = 0
        self.enabled = self.locked = False
        self.open = False
        """the master is in the middle of a mailbox"""

    @property
    def end(self) -> int:
        return self.start + self.length

    @property
    def mailbox(self) -> bool:
        return self.control & 3 == _MAILBOX

    @property
    def written(self) -> bool:
        """By the master, that is; else it reads."""
        return self.control >> 2 & 3 == 1

    @property
    def guards(self) -> bool:
        """Whether the watchdog watches it."""
        return bool(self.control & _WATCHDOG_TRIGGER)

    def touches(self, start: int, end: int) -> bool:
        return self.enabled and self.length > 0 and start < self.end and self.start < end


class Mapping(NamedTuple):
    """An FMMU; bits count from the start of the address before them."""

    logical: int
    length: int
    first_bit: int
    last_bit: int
    physical: int
    physical_bit: int
    way: int

    @property
    def bytewise(self) -> bool:
        return self.first_bit == 0 and self.last_bit == 7 and self.physical_bit == 0


class Controller:
    """``memory`` is what a master sees, but for the time."""

    _MASKS = reg.write_masks()

    def __init__(self, firmware: Firmware, eeprom: Eeprom) -> None:
        self.firmware = firmware
        self.eeprom = eeprom
        self.memory = bytearray(reg.MEMORY_END)
        self.managers = [Manager(number) for number in range(reg.MANAGERS)]
        self.restart()

    def restart(self) -> None:
        """As at switch-on."""
        memory = self.memory
        memory[:] = bytes(reg.MEMORY_END)
        constants = reg.constants()
        memory[: len(constants)] = constants
        memory[0x100] = 0x01
        _WORD.pack_into(memory, reg.ALIAS, self.eeprom.alias)
        memory[reg.DIVIDER : reg.DIVIDER + 2] = _WORD.pack(0x09C2)
        memory[0x410:0x412] = memory[reg.WATCHDOG_TIME : reg.WATCHDOG_TIME + 2] = _WORD.pack(1000)
        memory[reg.WATCHDOG_STATUS] = 1
        memory[reg.SPEED_START : reg.SPEED_START + 2] = _WORD.pack(0x1000)
        self.eeprom.restart(memory)
        self._load_managers()
        self.mappings: list[Mapping] = []

    # -- addressing ------------------------------------------------------------------------------

    def word(self, address: int) -> int:
        memory = self.memory
        return memory[address] | memory[address + 1] << 8

    def answers_to(self, station: int) -> bool:
        """Whether the slave has this station address, or the alias where that is used."""
        memory = self.memory
        if memory[0x010] | memory[0x011] << 8 == station:
            return True
        return bool(memory[0x103] & _ALIAS_USED) and self.word(reg.ALIAS) == station

    # -- access by address -----------------------------------------------------------------------

    def read(self, start: int, length: int, now_ns: int) -> bytes | None:
        """What a master reads, None when it may not."""
        end = start + length
        if end > reg.MEMORY_END or not length:
            return None
        if end > reg.MEMORY:
            return self._read_memory(start, end, now_ns)
        if end > reg.SYSTEM_TIME and start < reg.SYNC_END:
            self.firmware.clock_read(now_ns)
        return bytes(self.memory[start:end])

    def write(self, start: int, data: bytes, now_ns: int) -> bool:
        """Write what a master may write of it; False when it may write nothing there."""
        end = start + len(data)
        if end > reg.MEMORY_END or not data:
            return False
        if end > reg.MEMORY:
            return self._write_memory(start, data, now_ns)
        memory, masks = self.memory, self._MASKS
        for place, byte in enumerate(data, start):
            mask = masks[place]
            if mask:
                memory[place] = memory[place] & ~mask | byte & mask
        self._written(start, end, data, now_ns)
        return True

    def _written(self, start: int, end: int, data: bytes, now_ns: int) -> None:
        """Act on the registers among these."""
        memory, firmware = self.memory, self.firmware
        if (start < reg.ALIAS + 2 and end > reg.STATION) or start <= 0x103 < end:
            firmware.remapped()
        if start <= reg.CONTROL_AL < end:
            firmware.control(self.word(reg.CONTROL_AL), now_ns)
        if start < reg.ERRORS_END and end > reg.RECEIVE_ERRORS:
            memory[reg.RECEIVE_ERRORS : reg.ERRORS_END] = bytes(reg.ERRORS_END - reg.RECEIVE_ERRORS)
        if start < reg.WATCHDOG_COUNT + 2 and end > reg.WATCHDOG_COUNT:
            memory[reg.WATCHDOG_COUNT : reg.WATCHDOG_COUNT + 2] = b"\0\0"
        if start < reg.WATCHDOG_TIME + 2 and end > reg.DIVIDER:
            firmware.watchdog_set(now_ns)
        if start < reg.EEPROM_END and end > reg.EEPROM_CONTROL:
            self.eeprom.written(memory, start, data)
        if start < reg.FMMU + reg.FMMUS * reg.FMMU_BYTES and end > reg.FMMU:
            self._load_mappings()
            firmware.remapped()
        if start < reg.MANAGER + reg.MANAGERS * reg.MANAGER_BYTES and end > reg.MANAGER:
            self._managers_written(start, end, now_ns)
        if start < reg.SYNC_END and end > reg.RECEIVE_TIME:
            firmware.clock_written(start, data, now_ns)

    # -- sync managers ---------------------------------------------------------------------------

    def _managers_written(self, start: int, end: int, now_ns: int) -> None:
        before = [(m.start, m.length, m.enabled) for m in self.managers]
        self._load_managers()
        for manager, was in zip(self.managers, before, strict=True):
            if (manager.start, manager.length, manager.enabled) != was:
                self.set_full(manager, full=False)
                manager.open = False
        self.firmware.remapped()
        place = reg.MANAGER + reg.MANAGER_BYTES + 6
        if start <= place < end and (self.memory[place] ^ self.memory[place + 1]) & _REPEAT:
            self.firmware.repeat(now_ns)

    def acknowledge_repeat(self) -> None:
        """Show the master that its request for a repetition was seen."""
        place = reg.MANAGER + reg.MANAGER_BYTES + 6
        memory = self.memory
        memory[place + 1] = memory[place + 1] & ~_REPEAT | memory[place] & _REPEAT

    def _load_managers(self) -> None:
        for manager in self.managers:
            place = reg.MANAGER + reg.MANAGER_BYTES * manager.number
            start, length, control, _, activate, pdi = _BLOCK.unpack_from(self.memory, place)
            manager.start, manager.length, manager.control = start, length, control
            manager.enabled = bool(activate & _ENABLE)
            manager.locked = bool(pdi & _LOCKED)

    def lock(self, number: int, *, locked: bool) -> None:
        """The firmware takes a sync manager out of service, or gives it."""
        manager = self.managers[number]
        if manager.locked == locked:
            return
        manager.locked = locked
        place = reg.MANAGER + reg.MANAGER_BYTES * number + 7
        self.memory[place] = self.memory[place] & ~_LOCKED | locked
        self.set_full(manager, full=False)
        manager.open = False
        self.firmware.remapped()

    def is_full(self, manager: Manager) -> bool:
        place = reg.MANAGER + reg.MANAGER_BYTES * manager.number + 5
        return bool(self.memory[place] & FULL)

    def set_full(self, manager: Manager, *, full: bool) -> None:
        place = reg.MANAGER + reg.MANAGER_BYTES * manager.number + 5
        self.memory[place] = self.memory[place] & ~FULL | (FULL if full else 0)

    def _manager_of(self, start: int, end: int) -> Manager | None:
        """The first sync manager whose area is touched."""
        for manager in self.managers:
            if manager.touches(start, end):
                return manager
        return None

    def _read_memory(self, start: int, end: int, now_ns: int) -> bytes | None:
        manager = self._manager_of(start, end)
        if manager is None:
            return bytes(self.memory[start:end])
        if manager.locked or manager.written or not manager.start <= start < end <= manager.end:
            return None
        if not manager.mailbox:
            if end == manager.end:
                self.firmware.inputs_read(now_ns)
            return bytes(self.memory[start:end])
        if not self.is_full(manager) or not (manager.open or start == manager.start):
            return None
        found = bytes(self.memory[start:end])
        manager.open = end != manager.end
        if not manager.open:
            self.set_full(manager, full=False)
            self.firmware.mailbox_read(now_ns)
        return found

    def _write_memory(self, start: int, data: bytes, now_ns: int) -> bool:
        end = start + len(data)
        if start < reg.MEMORY:
            return False
        manager = self._manager_of(start, end)
        if manager is None:
            self.memory[start:end] = data
            return True
        if manager.locked or not manager.written or not manager.start <= start < end <= manager.end:
            return False
        if not manager.mailbox:
            self.memory[start:end] = data
            if end == manager.end:
                self.firmware.outputs_written(now_ns)
            return True
        if self.is_full(manager) or not (manager.open or start == manager.start):
            return False
        self.memory[start:end] = data
        manager.open = end != manager.end
        if not manager.open:
            self.set_full(manager, full=True)
            box = bytes(self.memory[manager.start : manager.end])
            # The firmware takes the message out at once.
            self.set_full(manager, full=False)
            self.firmware.mailbox_written(box, now_ns)
        return True

    def post(self, number: int, message: bytes) -> bool:
        """Put a message into a mailbox the master reads; False when the last is still there."""
        manager = self.managers[number]
        if not manager.enabled or manager.locked or self.is_full(manager):
            return False
        if manager.start < reg.MEMORY or manager.end > reg.MEMORY_END:
            return False
        box = message[: manager.length].ljust(manager.length, b"\0")
        self.memory[manager.start : manager.end] = box
        self.set_full(manager, full=True)
        return True

    # -- logical memory --------------------------------------------------------------------------

    def _load_mappings(self) -> None:
        self.mappings = []
        for number in range(reg.FMMUS):
            block = _FMMU.unpack_from(self.memory, reg.FMMU + reg.FMMU_BYTES * number)
            logical, length, first, last, place, bit, way, active = block
            if active & 1 and length and way & 3:
                self.mappings.append(
                    Mapping(logical, length, first & 7, last & 7, place, bit & 7, way & 3)
                )

    def may(self, way: int, start: int, end: int) -> Manager | bool:
        """Whether an FMMU gets through to these addresses, and the sync manager of buffered data
        that it meets there."""
        if start < reg.MEMORY or end > reg.MEMORY_END:
            return end <= reg.MEMORY
        manager = self._manager_of(start, end)
        if manager is None:
            return True
        within = manager.start <= start < end <= manager.end
        if manager.locked or manager.mailbox or not within or manager.written != (way == WRITE):
            return False
        return manager
