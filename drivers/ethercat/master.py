"""The EtherCAT fieldbus: bring-up, the exchange of each tick, and the watch over the slaves.

Tick k collects the frame that tick k-1 published. SYNC0 comes shortly after each tick began and the
frame passes after it, so that frame carries what was sampled at SYNC0 k-1, and what it brings acts
at SYNC0 k: a value sampled in tick k-1 is read in tick k, and the torque computed from it acts in
tick k+1. The same two ticks as on CAN.
"""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tonus.config.schema.bus import DistributedClocks, EthercatBus
from tonus.config.schema.root import Config
from tonus.config.timeouts import watchdog_ms
from tonus.drivers.devices.drive import require_interpolation
from tonus.drivers.devices.drive_errors import Errors
from tonus.drivers.errors import BringUpError, DriverError
from tonus.drivers.ethercat.al import ERROR, AlState
from tonus.drivers.ethercat.inputs import Inputs
from tonus.drivers.ethercat.phase import Phase
from tonus.drivers.ethercat.recovery import Recovery
from tonus.drivers.ethercat.slave import Slave, encoder, slaves
from tonus.drivers.ethercat.status import SlaveStatus
from tonus.drivers.ethercat.watch import Watch
from tonus.drivers.ethercat.wire import Found, Wire
from tonus.drivers.events import EventLog
from tonus.drivers.exchange import Exchange
from tonus.drivers.fieldbus import BusEvent, Progress
from tonus.drivers.process_image import ProcessImage

Clock = Callable[[], int]
OpenWire = Callable[[EthercatBus, Clock], Wire]
_POLL_S = 1e-3
_ASK_AGAIN = 50
"""Polls after which a change of state is asked for again: the frame may have been lost."""
_FAREWELL = 3
"""Frames with zeros at the end: one may be lost."""


@dataclass
class LostFrames:
    """How often a frame did not come back, and how long ticks waited for it."""

    count: int = 0
    waited_ns: int = 0
    longest_ns: int = 0


class EthercatFieldbus:
    """A `Fieldbus` on a `Wire`.

    Until the first `collect` a task exchanges process data each millisecond, which is what keeps
    the slaves in OP; from then on the ticks do.
    """

    def __init__(
        self, config: Config, image: ProcessImage, open_wire: OpenWire, clock: Clock | None = None
    ) -> None:
        """``clock`` gives ns and is the running loop's by default. Raises `DriverError` for a PDO
        mapping or an interpolation period that control cannot work with."""
        if not isinstance(config.fieldbus, EthercatBus):
            raise DriverError(f"fieldbus kind {config.fieldbus.kind} is not ethercat")
        self._bus = bus = config.fieldbus
        period_us = config.control.rates.period_us
        for key, profile in bus.every_profile.items():
            require_interpolation(profile, key, period_us)
        self.image = image
        self.channels: tuple[str, ...] = ()
        self.lost = LostFrames()
        self._period_ns = config.control.rates.period_ns
        self._watchdog_ms = watchdog_ms(bus, config.tolerance, period_us)
        self._open_wire = open_wire
        self._clock = clock
        self._slaves = slaves(bus, config.robot)
        self._events = EventLog()
        places = {each.axis: each.where for each in self._slaves if each.axis is not None}
        self._exchange = exchange = Exchange(
            config.robot,
            bus.force_cell,
            config.control.freshness,
            image,
            self._events,
            [places.get(axis, bus.interface) for axis in range(config.robot.cables)],
        )
        self._axes = [each for each in self._slaves if each.axis is not None]
        self._inputs = Inputs(self._slaves, exchange)
        self._encoders = [
            (each.axis, encoder(each)) for each in self._axes if each.axis is not None
        ]
        self._idle = [bytes(each.sizes.outputs) for each in self._slaves]
        self._outputs = list(self._idle)
        self._expected = sum(each.counts(AlState.OP) for each in self._slaves)
        self._everyone = [True] * len(self._slaves)
        self._watch = Watch(bus, exchange, self._events)
        self._recovery = Recovery(
            bus, self._watch, exchange, self._events, self._set_clocks, self._look_soon
        )
        self._wire: Wire | None = None
        self._now: Clock = _loop_clock
        self._pump_task: asyncio.Task[None] | None = None
        self._ticking = False
        self._found = 0
        self._sent_tick: int | None = None
        self._sent_ns = 0
        self._phase = Phase(bus.clocks, self._period_ns)
        self._codes = [0] * config.robot.cables
        self._errors = {each.number: Errors(each.profile) for each in self._axes}
        self._next_look = 0
        self._look_now = False

    # -- bring-up ---------------------------------------------------------------------------

    async def start(self, progress: Progress) -> None:
        """Raises `BringUpError`, one line that names every slave that failed and why."""
        self._exchange.forget()
        self._now = self._clock or _clock_of_the_loop()
        self._wire = wire = self._open_wire(self._bus, self._now)
        started = False
        try:
            self._identify(await wire.scan(), progress)
            progress(f"configuring {len(self._slaves)} slaves on {self._bus.interface}")
            for slave in self._slaves:
                try:
                    await slave.configure(wire.objects(slave.number), self._exchange)
                except DriverError as error:
                    raise BringUpError(
                        f"bring-up failed: {slave.where} ({slave.title}): {error}"
                    ) from error
            self._phase.align(await wire.align_clocks())
            await wire.map([each.sizes for each in self._slaves], self._watchdog_ms)
            for slave in self._slaves:
                await wire.start_sync(slave.number, self._period_ns, self._phase.sync0_ns)
            await self._reach(AlState.SAFEOP)
            self._phase.lose()
            self._phase.forget()
            self._pump_task = asyncio.get_running_loop().create_task(self._pump())
            progress("in SAFEOP, waiting for the clocks")
            await self._settle()
            await self._reach(AlState.OP)
            self._watch.begin(self._slaves)
            progress(f"{len(self._slaves)} slaves on {self._bus.interface} are in OP")
            started = True
        finally:
            if not started:
                await self.stop()
        self._events.take()

    def _identify(self, found: list[Found], progress: Progress) -> None:
        """Every slave has to be the device the configuration has in its place."""
        self._found = len(found)
        problems = []
        if len(found) != len(self._slaves):
            problems.append(f"{len(found)} slaves answer, configured are {len(self._slaves)}")
        for slave, there in zip(self._slaves, found, strict=False):
            problem = slave.identify(there)
            if problem:
                problems.append(f"{slave.where} ({slave.title}) {problem}")
        if not problems:
            return
        progress("what answers on the cable, in its order:")
        for number, there in enumerate(found, start=1):
            progress(f"  {self._bus.interface}/{number} {there}")
        raise BringUpError("bring-up failed: " + "; ".join(problems))

    async def _reach(self, state: AlState) -> None:
        """Ask every slave for ``state`` and wait until all are there. Raises `BringUpError`."""
        assert self._wire is not None
        wire, loop = self._wire, asyncio.get_running_loop()
        behind: list[tuple[Slave, SlaveStatus | None]] = [(slave, None) for slave in self._slaves]
        end = loop.time() + self._bus.master.state_timeout_ms * 1e-3
        found: list[SlaveStatus | None] = [None] * len(self._slaves)
        for poll in itertools.count():
            if poll % _ASK_AGAIN == 0:
                wire.control({slave.number: state for slave, _ in behind})
            wire.look()
            await asyncio.sleep(_POLL_S)
            found = wire.looked() or found
            behind = [
                (slave, status)
                for slave, status in zip(self._slaves, found, strict=True)
                if status is None or status.state != state or status.error
            ]
            if not behind:
                return
            refused = any(status is not None and status.error for _, status in behind)
            if refused or loop.time() >= end:
                told = "; ".join(
                    f"{slave.where} ({slave.title}): {status or 'no answer'}"
                    for slave, status in behind
                )
                raise BringUpError(f"bring-up failed: {state.name} was not reached: {told}")

    async def _settle(self) -> None:
        """Wait until every slave's clock is close to the reference. Raises `BringUpError`."""
        assert self._wire is not None
        clocks, loop = self._bus.clocks, asyncio.get_running_loop()
        end = loop.time() + clocks.settle_ms * 1e-3
        while True:
            self._wire.look()
            await asyncio.sleep(_POLL_S)
            found = self._wire.looked()
            if found is None or None in found:
                away = None
            else:
                away = max(abs(status.difference_ns) for status in found if status is not None)
                if away <= clocks.settle_ns and self._phase.known:
                    return
            if loop.time() >= end:
                seen = "no answer" if away is None else f"{away} ns apart"
                raise BringUpError(
                    f"bring-up failed: the slaves' clocks did not settle within "
                    f"{clocks.settle_ms} ms: {seen}, allowed are {clocks.settle_ns} ns"
                )

    async def _pump(self) -> None:
        while True:
            self._receive(None)
            self._send(self._idle, None)
            await asyncio.sleep(_POLL_S)

    # -- the tick ---------------------------------------------------------------------------

    def collect(self, tick: int) -> None:
        wire = self._wire
        assert wire is not None
        if not self._ticking:
            self._begin_ticking(tick)
        # First who is there: the look went out with the frame that is taken next.
        found = wire.looked()
        if found is not None:
            self._watch.see(found, wire)
        delivers = self._receive(self._sent_tick)
        if delivers is not None and self._sent_tick is not None:
            self._take_inputs(wire.inputs, delivers, *self._sampled(tick, self._sent_tick))
        self._sent_tick = None
        self._exchange.fill(tick)

    def publish(self, tick: int) -> None:
        assert self._wire is not None
        controlwords, torques = self._exchange.commands()
        outputs = self._outputs
        for slave, (axis, encode) in zip(self._axes, self._encoders, strict=True):
            outputs[slave.number] = encode(controlwords[axis], torques[axis])
        self._send(outputs, tick)
        if tick >= self._next_look or self._look_now:
            self._next_look = tick + self._bus.master.watch_ticks
            self._look_now = False
            self._wire.look()

    @property
    def clocks(self) -> DistributedClocks:
        return self._bus.clocks

    @property
    def leads(self) -> bool:
        """The loop's phase is to follow this segment's reference clock."""
        return self._bus.clocks.pacing == "distributed_clock"

    def phase_error_ns(self, due_ns: int) -> int | None:
        """`Phase.error_ns`."""
        return self._phase.error_ns(due_ns)

    def _send(self, outputs: list[bytes], tick: int | None) -> None:
        assert self._wire is not None
        self._sent_ns = self._wire.send(outputs)
        self._sent_tick = tick

    def _receive(self, tick: int | None) -> Sequence[bool] | None:
        """Take the frame that was sent: which slaves' inputs it brought, None: nobody's."""
        wire = self._wire
        assert wire is not None
        began = self._now()
        counter = wire.receive()
        if not self._sent_ns:
            return None
        where = self._bus.interface
        if counter is None:
            self._lose(self._now() - began, tick)
            return None
        if not self._clock_fits(wire.reference_ns):
            if tick is not None:
                text = "a frame came back that an earlier tick had sent"
                self._events.counted("stale_frame", where, text)
            return None
        if counter == self._expected:
            return self._everyone
        self._look_now = True
        if tick is not None:
            text = f"working counter {counter}, expected is {self._expected}"
            self._events.counted("wrong_working_counter", where, text)
        present = self._watch.present
        return present.delivers if present is not None and counter == present.counter else None

    def _lose(self, waited_ns: int, tick: int | None) -> None:
        self._phase.lose()
        if tick is None:
            return
        lost = self.lost
        lost.count += 1
        lost.waited_ns += waited_ns
        lost.longest_ns = max(lost.longest_ns, waited_ns)
        self._look_now = True
        text = f"the frame of tick {tick} did not come back within {waited_ns / 1000:.0f} us"
        self._events.counted("frame_lost", self._bus.interface, text)

    def _clock_fits(self, reference_ns: int | None) -> bool:
        if reference_ns is None:
            return True
        if not self._phase.fits(reference_ns, self._sent_ns):
            return False
        if self._ticking:
            where, after = self._bus.interface, self._phase.near_sync0_ns(reference_ns)
            if after is None:
                self._events.end("frame_near_sync", where)
            else:
                text = f"the frame passed {after / 1000:.0f} us after SYNC0"
                self._events.begin("frame_near_sync", where, text)
        return True

    def _sampled(self, tick: int, sent: int) -> tuple[int, int, int]:
        """`Phase.sampled`; without a reference clock as if the frame had been on time."""
        reference_ns = self._wire.reference_ns if self._wire is not None else None
        if reference_ns is None:
            return sent, 0, 0
        return self._phase.sampled(reference_ns, tick, sent)

    def _take_inputs(
        self,
        inputs: list[bytes],
        delivers: Sequence[bool],
        sampled: int,
        sampled_ns: int,
        doubt_ns: int,
    ) -> None:
        self._inputs.take(inputs, delivers, sampled, sampled_ns, doubt_ns)
        codes = self._exchange.error_codes.tolist()
        if codes != self._codes:
            self._tell_errors(codes)

    def _tell_errors(self, codes: list[int]) -> None:
        for slave in self._axes:
            assert slave.axis is not None
            code = codes[slave.axis]
            if code and code != self._codes[slave.axis]:
                text = f"{slave.title}: 0x{code:04X}: {self._errors[slave.number].text(code)}"
                self._events.counted("drive_error", slave.where, text, kind=code)
        self._codes = codes

    def _begin_ticking(self, tick: int) -> None:
        self._ticking = True
        self._stop_pump()
        self._next_look = tick
        self._phase.count_anew()
        # What the pump sent last is nobody's sample.
        self._sent_tick = None

    # -- beside the tick --------------------------------------------------------------------

    def take_events(self) -> list[BusEvent]:
        return self._events.take()

    async def sdo_read(self, axis: int, index: int, subindex: int) -> bytes:
        assert self._wire is not None
        return await self._wire.objects(self._of_axis(axis).number).read(index, subindex)

    async def sdo_write(self, axis: int, index: int, subindex: int, data: bytes) -> None:
        assert self._wire is not None
        await self._wire.objects(self._of_axis(axis).number).write(index, subindex, data)

    def _of_axis(self, axis: int) -> Slave:
        return next(slave for slave in self._slaves if slave.axis == axis)

    async def recover(self) -> None:
        assert self._wire is not None
        await self._recovery(self._wire)

    async def _set_clocks(self, wire: Wire) -> None:
        """Raises `DriverError`."""
        try:
            self._phase.align(await wire.align_clocks())
            for slave in self._slaves:
                await wire.start_sync(slave.number, self._period_ns, self._phase.sync0_ns)
        finally:
            # The frame that is under way still carries the old time.
            self._sent_ns = 0
            self._phase.forget()

    def _look_soon(self) -> None:
        self._look_now = True

    async def stop(self) -> None:
        """Power off, then all slaves to PREOP by way of SAFEOP; safe at any point."""
        wire = self._wire
        if wire is None:
            return
        self._stop_pump()
        self._ticking = False
        if self._watch.watched:
            for _ in range(_FAREWELL):
                self._receive(None)
                self._send(self._idle, None)
                await asyncio.sleep(_POLL_S)
            self._receive(None)
        there = self._slaves[: self._found]
        wire.control({slave.number: AlState.PREOP | ERROR for slave in there})
        await asyncio.sleep(_POLL_S)
        wire.close()
        self._wire = None
        self._watch.begin([])

    def _stop_pump(self) -> None:
        if self._pump_task is not None:
            self._pump_task.cancel()
            self._pump_task = None


def _loop_clock() -> int:
    raise AssertionError("the clock is available only while a loop runs")


def _clock_of_the_loop() -> Clock:
    loop = asyncio.get_running_loop()
    now_ns: Clock | None = getattr(loop, "now_ns", None)
    return now_ns or (lambda: round(loop.time() * 1e9))
