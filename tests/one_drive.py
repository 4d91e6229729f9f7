"""One emulated drive on a drum without a cable, and its owner's few words for it."""

from __future__ import annotations

from tonus.config import load
from tonus.config.schema.axis import Brake
from tonus.config.schema.lab import LabScript
from tonus.sim.devices.cia402.states import State
from tonus.sim.lab.engine import Lab

MS = 1_000_000
CONFIG = load("config/direct.yaml")[0]
SHUTDOWN, SWITCH_ON, ENABLE, DISABLE_VOLTAGE, QUICK_STOP = 0x06, 0x07, 0x0F, 0x00, 0x02
TORQUE_CONSTANT = 71000
BRAKE = Brake(torque=0.4, opening_ms=10.0, closing_ms=10.0)
"""of times that 0x3158 has by default"""


class OneDrive:
    """``errors``: code and register of every emergency, in order."""

    def __init__(self, *, brake: Brake | None = None, cable: bool = False) -> None:
        robot = CONFIG.robot.model_copy(update={"brake": brake})
        config = CONFIG.model_copy(update={"robot": robot})
        self.lab = Lab(config, LabScript(), seed=1, clock=lambda: 0)
        self.drive = self.lab.drives[0]
        self.errors: list[tuple[int, int]] = []
        self.drive.on_error = lambda code, register: self.errors.append((code, register))
        if not cable:
            self.lab.plant.cut_cable(0)
        self.write(0x3001, 5, TORQUE_CONSTANT)

    def write(self, index: int, sub: int, value: int) -> None:
        size = self.drive.objects.find(index, sub).kind.size
        data = (value & (1 << 8 * size) - 1).to_bytes(size, "little")
        self.drive.objects.write(index, sub, data)

    def read(self, index: int, sub: int = 0) -> int:
        return self.drive.objects.number(index, sub)

    def wait(self, ms: float) -> None:
        self.lab.advance(self.lab.now_ns + round(ms * MS))

    def enable(self, mode: int | None = None) -> None:
        if mode is not None:
            self.write(0x6060, 0, mode)
        for word in (SHUTDOWN, ENABLE):
            self.drive.controlword(word)
        assert self.drive.enabled

    def reset_fault(self) -> State:
        for word in (0x00, 0x80):
            self.drive.controlword(word)
        return self.drive.state

    @property
    def word(self) -> int:
        return self.drive.statusword()

    @property
    def powered(self) -> bool:
        return bool(self.lab.plant.powered[0])

    @property
    def rpm(self) -> float:
        return float(self.lab.plant.motor_rate[0]) * 30.0 / 3.141592653589793


def servo(mode: int) -> OneDrive:
    """Enabled in a mode, with a small position window and no following error."""
    bench = OneDrive()
    bench.write(0x6065, 0, 0xFFFFFFFF)
    bench.write(0x6067, 0, 60)
    bench.write(0x6068, 0, 5)
    bench.enable(mode)
    return bench


def until(bench: OneDrive, bit: int, within_ms: float = 5000.0) -> float:
    """ms until a statusword bit is set."""
    for passed in range(round(within_ms)):
        if bench.word & bit:
            return passed
        bench.wait(1)
    raise AssertionError(f"bit 0x{bit:04X} did not come")
