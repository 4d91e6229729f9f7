"""What the master makes of a bus in trouble: events, lost axes, and the way back."""

from __future__ import annotations

import asyncio
import random
import struct
from collections import deque

import can
import pytest
from hil.can_bench import CONFIG, PERIOD_S, Bench, enabled, on_lab
from loop import QUICK
from wired import CHANNEL

from tonus.config import load
from tonus.config.schema.bus import CanopenBus
from tonus.config.timeouts import master_timeout_ms
from tonus.drivers.canopen.master import CanopenFieldbus
from tonus.drivers.devices.tracker import TrackerInput
from tonus.drivers.exchange import UNTRUSTED
from tonus.drivers.fieldbus import BusEvent
from tonus.drivers.process_image import AxisCommand, AxisState, ProcessImage
from tonus.runtime.control.tuning import NO_CHANGE
from tonus.runtime.daemon import Daemon, Outcome
from tonus.runtime.operation.operator import Commander
from tonus.runtime.recording.taps import Level
from tonus.runtime.safety.sequence import Sequence
from tonus.runtime.states import Operator, State
from tonus.runtime.timing import clock
from tonus.runtime.timing.scheduler import VirtualPacing
from tonus.sim.lab.engine import Lab

FRESH = CONFIG.control.freshness.measurement_ticks
assert isinstance(CONFIG.fieldbus, CanopenBus)
TIMEOUT_S = 1e-3 * master_timeout_ms(CONFIG.fieldbus, CONFIG.fieldbus.drive, CONFIG.tolerance)
SILENCE_S = 1.5 * TIMEOUT_S


def told(bench: Bench, name: str) -> list[BusEvent]:
    return [event for event in bench.fieldbus.take_events() if event.name == name]


async def recovered(bench: Bench) -> None:
    """Recover while ticks go on."""
    recovery = asyncio.create_task(bench.fieldbus.recover())
    while not recovery.done():
        await bench.ticks(1)
    recovery.result()


def test_every_drive_stops_by_itself_when_the_daemon_is_killed() -> None:
    async def script(bench: Bench) -> None:
        await enabled(bench)
        bus = CONFIG.fieldbus
        assert isinstance(bus, CanopenBus)
        while (bench.tick - 1) % bus.master.heartbeat_ms:
            await bench.ticks(1)
        loop = asyncio.get_running_loop()
        killed = loop.time() - PERIOD_S

        def enabled_after(seconds: float) -> int:
            bench.lab.advance(round((killed + seconds) * 1e9))
            return sum(drive.enabled for drive in bench.lab.drives)

        assert enabled_after(0.99 * TIMEOUT_S) == 8
        assert enabled_after(TIMEOUT_S + PERIOD_S) == 0

    on_lab(script)


def test_drives_that_lost_the_masters_heartbeat_are_brought_back_by_a_reset() -> None:
    async def script(bench: Bench) -> None:
        await enabled(bench)
        await asyncio.sleep(SILENCE_S)
        bench.image.commands["command"] = AxisCommand.RESET_FAULT
        await bench.ticks(300)
        assert set(bench.image.axes["error_code"]) == {0x8130}
        assert set(bench.image.axes["state"]) == {AxisState.LOST}
        events = bench.fieldbus.take_events()
        assert sum(event.name == "emcy" for event in events) == 8
        text = next(event.text for event in events if event.name == "emcy")
        assert "a fault reset clears it after NMT reset communication" in text
        assert sum(event.name == "left_operational" for event in events) == 8
        await recovered(bench)
        back = told(bench, "recovered")
        assert {event.where for event in back} == {f"{CHANNEL[n]}/{n}" for n in range(1, 9)}
        await bench.ticks(20)
        assert set(bench.image.axes["state"]) == {AxisState.SWITCH_ON_DISABLED}
        assert not bench.image.axes["error_code"].any()
        bench.image.commands["command"] = AxisCommand.ENABLE
        await bench.ticks(20)
        assert set(bench.image.axes["state"]) == {AxisState.OPERATION_ENABLED}
        assert set(bench.image.axes["age"]) == {0}

    on_lab(script)


def test_a_drive_in_passive_error_needs_its_communication_reset_and_no_other_node() -> None:
    async def script(bench: Bench) -> None:
        await enabled(bench)
        bench.lab.nodes["can1", 5].device.fail(0x8120)
        await bench.ticks(700)
        assert bench.image.axes["state"][4] == AxisState.FAULT
        bench.image.commands["command"] = AxisCommand.RESET_FAULT
        await bench.ticks(10)
        assert bench.image.axes["state"][4] == AxisState.FAULT
        await recovered(bench)
        assert [event.where for event in told(bench, "recovered")] == ["can1/5"]
        await bench.ticks(10)
        assert set(bench.image.axes["state"]) == {AxisState.SWITCH_ON_DISABLED}

    on_lab(script)


@pytest.mark.parametrize("lasts", [False, True])
def test_an_amplifier_with_an_error_is_reset_and_reports_anew_what_lasts(lasts: bool) -> None:
    """Of an amplifier that was unplugged nobody takes the error back. Of a bridge that is still
    broken the amplifier tells after its reset, which counts."""

    async def script(bench: Bench) -> None:
        await enabled(bench)
        contact, node = bench.image.cells[8:9], bench.lab.nodes[CHANNEL[25], 25]
        node.device.fail(0x8120)
        await bench.ticks(20)
        assert contact["status"] == UNTRUSTED
        boot = node.boot

        def broken() -> None:
            boot()
            node.device.fail(0x5000)

        if lasts:
            node.boot = broken  # type: ignore[method-assign]
        await recovered(bench)
        assert [event.where for event in told(bench, "recovered")] == [f"{CHANNEL[25]}/25"]
        await bench.ticks(20)
        assert contact["age"] == 0
        assert contact["status"] == (UNTRUSTED if lasts else 0)

    on_lab(script)


def test_an_ordinary_fault_needs_the_controlword_only() -> None:
    async def script(bench: Bench) -> None:
        await enabled(bench)
        bench.lab.nodes["can3", 2].device.fail(0x2310)
        bench.image.commands["command"] = AxisCommand.RESET_FAULT
        await recovered(bench)
        await bench.ticks(10)
        assert told(bench, "recovered") == []
        assert set(bench.image.axes["state"]) == {AxisState.SWITCH_ON_DISABLED}

    on_lab(script)


def test_a_pulled_drive_stays_lost_until_it_is_plugged_in_and_brought_back() -> None:
    async def script(bench: Bench) -> None:
        await enabled(bench)
        bench.lab.unplug("can1", 3)
        await bench.ticks(300)
        await recovered(bench)
        (failure,) = told(bench, "recovery_failed")
        assert failure.where == "can1/3"
        assert "drive of axis 2: missing: no boot-up within 2000 ms" in failure.text
        bench.lab.replug("can1", 3)
        await bench.ticks(300)
        assert bench.image.axes["state"][2] == AxisState.LOST
        await recovered(bench)
        assert [event.where for event in told(bench, "recovered")] == ["can1/3"]
        await bench.ticks(30)
        assert bench.image.axes["state"][2] == AxisState.OPERATION_ENABLED

    on_lab(script)


@pytest.mark.parametrize("node", [1, 17])
def test_a_node_that_restarts_is_lost_until_it_is_configured_again(node: int) -> None:
    async def script(bench: Bench) -> None:
        await enabled(bench)
        bench.lab.nodes["can0", node].boot()
        await bench.ticks(20)
        (event,) = told(bench, "boot_up")
        assert event.where == f"can0/{node}"
        assert "lost until a reset brings it back" in event.text
        rows = bench.image.axes if node == 1 else bench.image.cells
        assert rows["age"][0] > FRESH
        await recovered(bench)
        await bench.ticks(20)
        assert rows["age"][0] == 0

    on_lab(script)


def test_a_fault_that_is_there_at_the_start_is_said_and_reset() -> None:
    async def script(bench: Bench) -> None:
        said: list[str] = []
        bench.lab.nodes["can0", 7].device.fail(0x3210)
        bench.lab.nodes["can0", 7].device.fail(0x8130)
        await bench.fieldbus.start(said.append)
        (line,) = [line for line in said if "has a fault" in line]
        assert line.startswith(
            "can0/7 drive of axis 6: has a fault, 0x8130 heartbeat of the master"
        )
        assert line.endswith("before it 0x3210")
        bench.image.commands["command"] = AxisCommand.ENABLE
        await bench.ticks(30)
        assert set(bench.image.axes["state"]) == {AxisState.OPERATION_ENABLED}

    on_lab(script)


class Unreliable(can.BusABC):
    """A lab's bus on which frames from drives are lost, late or doubled; it knows the truth."""

    def __init__(self, name: str, seed: int, chances: tuple[float, float, float]) -> None:
        self._bus = can.Bus(interface="tonus", channel=name)
        super().__init__(channel=name)
        self._random = random.Random(f"{name} {seed}")
        self._chances = chances
        self._held: deque[tuple[int, can.Message]] = deque()
        self._polls = 0
        self.sampled: dict[int, float] = {}
        """by identifier: time of the frame that was handed out last"""

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._bus.send(msg, timeout)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        while (message := self._bus.recv(0)) is not None:
            number = message.arbitration_id
            lost, late, doubled = self._chances if 0x181 <= number <= 0x188 else (0.0, 0.0, 0.0)
            fate = self._random.random()
            if fate < lost:
                continue
            hold = self._random.randint(1, 4) if fate < lost + late else 0
            ready = max([self._polls + hold, *(at for at, m in self._held if _same(m, message))])
            self._held.append((ready, message))
            if fate > 1.0 - doubled:
                self._held.append((ready, message))
        for place, (ready, message) in enumerate(self._held):
            if ready <= self._polls:
                del self._held[place]
                self.sampled[message.arbitration_id] = message.timestamp
                # What is late on the wire has the time at which it came off it.
                clock_s = asyncio.get_running_loop().time()
                stamp = message.timestamp if clock_s - message.timestamp < PERIOD_S else clock_s
                return can.Message(
                    timestamp=stamp,
                    arbitration_id=message.arbitration_id,
                    is_extended_id=False,
                    data=message.data,
                )
        self._polls += 1
        return None

    def shutdown(self) -> None:
        self._bus.shutdown()
        super().shutdown()


def _same(one: can.Message, other: can.Message) -> bool:
    return one.arbitration_id == other.arbitration_id


@pytest.mark.parametrize("seed", range(3))
def test_no_torque_rests_on_a_measurement_older_than_the_freshness(seed: int) -> None:
    """Answers lost, late by up to four periods, or doubled, a fifth of them each."""
    buses: dict[str, Unreliable] = {}

    def open_bus(name: str) -> can.BusABC:
        buses[name] = Unreliable(name, seed, (0.0, 0.0, 0.0))
        return buses[name]

    async def script(bench: Bench) -> None:
        await enabled(bench)
        for bus in buses.values():
            bus._chances = (0.2, 0.2, 0.2)
        bench.image.commands["torque"] = 0.5
        loop, powered, silent = asyncio.get_running_loop(), 0, 0
        for _ in range(400):
            bench.frames.clear()
            began = loop.time()
            await bench.ticks(1)
            for _, channel, identifier, data, sent in bench.frames:
                if not sent or not 0x201 <= identifier <= 0x208:
                    continue
                torque = struct.unpack_from("<h", data, 2)[0]
                age_s = began - buses[f"can{channel}"].sampled[identifier - 0x80]
                powered += torque != 0
                silent += torque == 0
                assert torque == 0 or age_s <= (FRESH + 1) * PERIOD_S, f"seed {seed}"
        assert powered > 100
        assert silent > 100

    on_lab(script, open_bus)


class Resetter:
    """Arms; after a fault resets once and arms again; ends when every drive is enabled again."""

    interrupted = False
    who = obstacle = ""
    select = 0
    change = NO_CHANGE

    def __init__(self) -> None:
        self.finished = False
        self.states: list[State] = []

    def stop(self, who: str = "") -> None: ...

    def refused(self, reason: str) -> None: ...

    def next(self, sequence: Sequence) -> Operator:
        state = sequence.state
        if self.states[-1:] != [state]:
            self.states.append(state)
        self.finished = State.FAULT in self.states and sequence.enabled and state is not State.FAULT
        if state is State.FAULT and sequence.elapsed == 0.5:
            return Operator.RESET
        return Operator.ARM if state is State.STANDBY else Operator.NONE


class Stalling(VirtualPacing):
    """The host stops the daemon once, for longer than the drives wait."""

    def __init__(self, at_s: float) -> None:
        self._at_ns = round(at_s * 1e9)

    async def until(self, due_ns: int) -> None:
        await super().until(due_ns)
        if due_ns >= self._at_ns:
            self._at_ns = 1 << 62
            await asyncio.sleep(SILENCE_S)


class Heard:
    """Names of events kept in memory, as a ring and an event sink."""

    def __init__(self) -> None:
        self.names: list[str] = []

    def __call__(
        self, stamp_ns: int, tick: int, level: Level, name: str, where: str, text: str
    ) -> None:
        self.names.append(name)

    def publish(self, payload: object, stamp_ns: int) -> None:
        """No record is kept."""


def stalled(operator: Commander, at_s: float) -> tuple[Outcome, Heard]:
    """The daemon on CAN, stopped once by its host."""
    config, scenario = load("config/can.yaml", "hold", QUICK)
    heard = Heard()

    async def main() -> Outcome:
        lab = Lab(config, scenario.lab, seed=1, clock=clock.loop_clock())
        lab.open()
        image = ProcessImage(8)
        daemon = Daemon(
            config,
            scenario,
            CanopenFieldbus(config, image),
            TrackerInput(image, lab.tracker),
            operator,
            ring=heard,
            events=heard,
            stopwatch=clock.Stopwatch(running=False),
        )
        try:
            return await daemon.run(lambda: Stalling(at_s), lambda _: None, lambda: None)
        finally:
            lab.close()

    return clock.run(main(), virtual=True), heard


def test_after_a_stalled_daemon_an_operators_reset_enables_the_drives_again() -> None:
    operator = Resetter()
    outcome, heard = stalled(operator, 3.0)
    assert outcome.state is State.REFERENCING
    assert operator.states == [
        State.OFF,
        State.STANDBY,
        State.REFERENCING,
        State.PRETENSION,
        State.HOLD,
        State.SAFE_STOP,
        State.FAULT,
        State.STANDBY,
        State.REFERENCING,
    ]
    assert heard.names.count("recovered") == 8
    assert not {"recovery_failed", "duplicate_pdo"} & set(heard.names)


class Hesitant(Resetter):
    """Resets, and takes it back with an emergency stop while the drives are being brought back."""

    def next(self, sequence: Sequence) -> Operator:
        if sequence.state is not State.FAULT:
            return Operator.NONE
        asked = round(sequence.elapsed * 1e3)
        self.finished = asked > 900
        return {500: Operator.RESET, 520: Operator.ESTOP}.get(asked, Operator.NONE)


def test_an_emergency_stop_ends_a_reset_that_waits_for_the_bus() -> None:
    outcome, heard = stalled(Hesitant(), 1.0)
    assert outcome.state is State.FAULT
    assert "recovered" not in heard.names
    assert heard.names.count("operator") == 1
