"""The electronic data sheets that lie beside the emulated devices, made from the devices."""

from __future__ import annotations

from tonus.config.schema.lab import LabScript
from tonus.config.schema.root import Config
from tonus.sim.can.canopen.eds import eds
from tonus.sim.can.canopen.node import Node
from tonus.sim.can.wire.faulty import FaultyChannel
from tonus.sim.devices.device import Device
from tonus.sim.devices.eds.drive import EdsDrive
from tonus.sim.devices.epos4.drive import Epos4
from tonus.sim.devices.force_cell import ForceCell
from tonus.sim.errors import LabError
from tonus.sim.lab.engine import Lab

_EPOS4_RATES = (20, 50, 125, 250, 500, 800, 1000)
_CELL_RATES = (10, 20, 50, 125, 250, 500, 800, 1000)
_QUEUE = 8


def sheets(config: Config) -> dict[str, str]:
    """File name to text. Raises `LabError` for a configuration without a lab section."""
    if config.lab is None:
        raise LabError(f"configuration {config.name} has no lab section")
    lab = Lab(config, LabScript(), seed=0, clock=lambda: 0)
    noise = config.lab.noise.force_cell
    devices: dict[str, tuple[Device, tuple[int, ...]]] = {
        "epos4.eds": (Epos4(0, 1, lab.samples, lab), _EPOS4_RATES),
        "force_cell.eds": (ForceCell((0,), 1, lab.samples, noise, lab), _CELL_RATES),
        "force_cell_4.eds": (ForceCell((0, 1, 2, 3), 1, lab.samples, noise, lab), _CELL_RATES),
    }
    found = {
        node.device.sheet.name: eds(node, node.device.sheet.name, _CELL_RATES)
        for node in lab.nodes.values()
        if isinstance(node.device, EdsDrive)
    }
    for name, (device, rates) in devices.items():
        node = Node(device, 1, FaultyChannel("can", 1_000_000, _QUEUE, 0), lab)
        found[name] = eds(node, name, rates)
    return found
