"""What a fieldbus of one's own is made of: see docs/tutorials/your_fieldbus.md."""

from tonus.config.schema.bus import Amplifier, BusNode, DriveBus, FieldbusSection, ForceCell
from tonus.drivers.cia301.setting import apply
from tonus.drivers.devices.drive import settings
from tonus.drivers.errors import BringUpError, DriverError, SdoError
from tonus.drivers.events import EventLog, Meaning
from tonus.drivers.exchange import Exchange
from tonus.drivers.fieldbus import BusEvent, Fieldbus, FrameTap, Progress
from tonus.drivers.process_image import ProcessImage
from tonus.runtime.timing.clock import loop_clock
from tonus.sim.lab.direct import DirectPort
from tonus.sim.lab.hardware import Hardware
from tonus.tools.check.finding import Finding
from tonus.tools.fieldbus.contract import violations
from tonus.tools.fieldbus.kind import FieldbusKind

__all__ = [
    "Amplifier",
    "BringUpError",
    "BusEvent",
    "BusNode",
    "DirectPort",
    "DriveBus",
    "DriverError",
    "EventLog",
    "Exchange",
    "Fieldbus",
    "FieldbusKind",
    "FieldbusSection",
    "Finding",
    "ForceCell",
    "FrameTap",
    "Hardware",
    "Meaning",
    "ProcessImage",
    "Progress",
    "SdoError",
    "apply",
    "loop_clock",
    "settings",
    "violations",
]
