"""From a ``fieldbus:`` section to its registration."""

from __future__ import annotations

from tonus.config.schema.bus import SHIPPED, FieldbusSection, foreign
from tonus.config.schema.outside import OutsideError
from tonus.tools.errors import ToolError
from tonus.tools.fieldbus.canopen import CANOPEN
from tonus.tools.fieldbus.direct import DIRECT
from tonus.tools.fieldbus.ethercat import ETHERCAT
from tonus.tools.fieldbus.kind import FieldbusKind

KINDS: dict[str, FieldbusKind] = {"canopen": CANOPEN, "direct": DIRECT, "ethercat": ETHERCAT}
"""the shipped ones with devices of their own"""


def fieldbus_kind(bus: FieldbusSection) -> FieldbusKind:
    """The registration of one part of a fieldbus. Raises `ToolError`."""
    if bus.kind in SHIPPED:
        return KINDS[bus.kind]
    try:
        found = foreign(bus.kind)
    except OutsideError as error:
        raise ToolError(f"fieldbus.kind {bus.kind}: {error}") from error
    if not isinstance(found, FieldbusKind):
        raise ToolError(
            f"fieldbus.kind {bus.kind}: is not a tonus.fieldbus.FieldbusKind; make it one"
        )
    return found
