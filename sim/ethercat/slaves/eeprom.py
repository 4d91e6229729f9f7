"""The EEPROM interface of a slave controller: a word address, a command, eight bytes at a time."""

from __future__ import annotations

import struct

from tonus.sim.ethercat.slaves import registers as reg

_WRITE_ENABLE = 0x01
_EIGHT_BYTES = 0x40
_COMMAND = 0x07
_READ, _WRITE, _RELOAD = 1, 2, 4
_ERROR = 0x20
_NOT_ENABLED = 0x40
_BY_SLAVE = 0x01
_ALIAS_WORD = 4


class Eeprom:
    """Answers at once, so its busy bit is never seen."""

    def __init__(self, image: bytearray) -> None:
        self.image = image

    @property
    def alias(self) -> int:
        return int.from_bytes(self.image[2 * _ALIAS_WORD : 2 * _ALIAS_WORD + 2], "little")

    def restart(self, memory: bytearray) -> None:
        memory[reg.EEPROM_CONTROL] = _EIGHT_BYTES

    def put(self, word: int, value: int, size: int) -> None:
        """Have another content, as from the factory."""
        self.image[2 * word : 2 * word + size] = value.to_bytes(size, "little")

    def written(self, memory: bytearray, start: int, data: bytes) -> None:
        """Some of the interface's registers were written, ``data`` from ``start`` on."""
        place = reg.EEPROM_CONTROL - start
        if not 0 <= place < len(data):
            return
        enable = data[place] & _WRITE_ENABLE
        command = data[place + 1] & _COMMAND if place + 1 < len(data) else 0
        if memory[reg.EEPROM_OWNER] & _BY_SLAVE:
            return
        status = 0
        (address,) = struct.unpack_from("<I", memory, reg.EEPROM_ADDRESS)
        at = 2 * address
        if command == _READ:
            found = bytes(self.image[at : at + 8]).ljust(8, b"\xff")
            memory[reg.EEPROM_DATA : reg.EEPROM_END] = found
        elif command == _WRITE:
            if enable and at + 2 <= len(self.image):
                self.image[at : at + 2] = memory[reg.EEPROM_DATA : reg.EEPROM_DATA + 2]
            else:
                status = _NOT_ENABLED | _ERROR
        elif command == _RELOAD:
            struct.pack_into("<H", memory, reg.ALIAS, self.alias)
        elif command:
            status = _ERROR
        memory[reg.EEPROM_CONTROL] = _EIGHT_BYTES
        memory[reg.EEPROM_CONTROL + 1] = status
