"""The predefined connection set of CiA 301: which 11-bit identifier means what."""

from __future__ import annotations

NMT = 0x000
SYNC = 0x080
EMCY = 0x080
TPDO1 = 0x180
RPDO1 = 0x200
SDO_RESPONSE = 0x580
SDO_REQUEST = 0x600
HEARTBEAT = 0x700

PDO_SPACING = 0x100
"""Between the identifiers of PDO n and PDO n+1 of one node."""
