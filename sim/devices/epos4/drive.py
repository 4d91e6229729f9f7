"""An emulated EPOS4 Compact 50/8 as a device without a bus. The speed is the encoder's true one,
whatever 0x3010:1 says."""

from __future__ import annotations

from tonus.config.schema.axis import Brake
from tonus.config.schema.lab import PowerStage
from tonus.sim.devices.cia402.drive import QUICK_STOP_RAMP, Cia402Drive
from tonus.sim.devices.cia402.servo import RPM
from tonus.sim.devices.cia402.states import POWERED
from tonus.sim.devices.epos4.errors import CODES, CORRUPT_PARAMETERS, ERRORS
from tonus.sim.devices.epos4.objects import (
    POWER_OFF_ONLY,
    RECEIVE_PDOS,
    SENSORS,
    TRANSMIT_PDOS,
    dictionary,
    has_sensors,
)
from tonus.sim.devices.epos4.values import connect, scale_speeds
from tonus.sim.devices.objects import INTERNAL, PASSWORD, WRONG_STATE, AbortError
from tonus.sim.devices.samples import Samples
from tonus.sim.devices.store import connect_store
from tonus.sim.devices.timers import Timers

_QUICK_STOP = 3


class Epos4(Cia402Drive):
    """One drive on one axis of the plant."""

    receive_pdos = RECEIVE_PDOS
    transmit_pdos = TRANSMIT_PDOS
    longest_mapping = 12
    consumers = 2
    event_timer = False
    error_behaviour = True

    def __init__(
        self,
        axis: int,
        node_id: int,
        samples: Samples,
        timers: Timers,
        stage: PowerStage | None = None,
        brake: Brake | None = None,
    ) -> None:
        objects = dictionary(node_id)
        super().__init__(
            axis,
            objects,
            objects,
            samples,
            timers,
            stage,
            ERRORS,
            CODES,
            brake,
        )
        self._connect()
        self.reset()

    # -- objects ---------------------------------------------------------------------------------

    def _connect(self) -> None:
        find, output = self.objects.find, self._output
        connect(self.axis, self.objects, self._samples, self._timers, output.servo, output.guard)
        find(0x1011, 4).write = self._locked
        for key in ((0x6060, 0), (0x3001, 1), (0x3001, 2), (0x3001, 5), (0x6080, 0), (0x60C2, 1)):
            self._follow(key)
        for key in POWER_OFF_ONLY:
            self._guarded(key)
        find(0x1011, 4).read = lambda: 1
        connect_store(self.objects, self._can_store)

    def _guarded(self, key: tuple[int, int]) -> None:
        entry = self.objects.find(*key)

        def write(value: int) -> None:
            if self._machine.state in POWERED:
                raise AbortError(WRONG_STATE)
            if key == (0x3000, 1) and not has_sensors(value):
                raise AbortError(INTERNAL)
            entry.value = value
            if key[0] in SENSORS:
                self._lose_position()
            self._configure()

        entry.write = write

    def _configure(self) -> None:
        number = self.objects.number
        nominal = number(0x3001, 1) * 1e-3
        self._samples.set_nominal_current(self.axis, nominal)
        self._set_points.set_period(number(0x60C2, 1))
        servo = self._output.servo
        servo.velocity_unit = servo.motor_speed_unit = RPM * scale_speeds(self.objects)
        # Torque is relative to the rated torque; without a torque constant there is none.
        self._output.set_scale(nominal * 1e-3 if number(0x6076, 0) else 0.0)
        self._show()  # a period is part of what a set-point meets

    def _can_store(self) -> bool:
        sound = CORRUPT_PARAMETERS not in self._errors.present
        return sound and self._output.guard.supplied

    def _locked(self, value: int) -> None:
        """The maker's own."""
        del value
        raise AbortError(PASSWORD)

    def _brakes(self, reaction: str) -> bool:
        if reaction == "A":
            self._output.braking.ramp = QUICK_STOP_RAMP
            return self.objects.number(0x6007, 0) == _QUICK_STOP
        return super()._brakes(reaction)

    def reset(self) -> None:
        """The stored parameters are loaded; the encoder counts from 0."""
        super().reset()
        self.objects.find(0x200A, 0).value = self.objects.number(0x2001, 0)
