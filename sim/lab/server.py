"""A lab in real time: its channels as Unix sockets, its EtherCAT segment on a network interface,
its tracker as UDP datagrams, and its door.

The lab itself is lazy. The server brings it forward when a client sends, and when something is due
that a client would notice; frames that end within ``lab.bus.coalesce_us`` go out in one packet.
"""

from __future__ import annotations

import asyncio
import select
import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from tonus.config.places import LAB_DOOR
from tonus.config.schema.bus import CanopenBus, EthercatBus
from tonus.config.schema.root import Config
from tonus.sim.can.bridge import Bridge
from tonus.sim.can.packet import PACKET_BYTES, WISHES, Wishes, socket_path, sound
from tonus.sim.can.wire.channel import Channel
from tonus.sim.can.wire.frame import Frame
from tonus.sim.errors import LabError
from tonus.sim.ethercat.port import SegmentPort
from tonus.sim.ethercat.veth import close_pair, open_pair
from tonus.sim.lab.client import Client, Sent, SentTogether, apart, rehearse, sent_ns
from tonus.sim.lab.door import Door
from tonus.sim.lab.door_socket import DoorSocket, remove_stale
from tonus.sim.lab.engine import Lab
from tonus.sim.lab.timer import WakeUp

_IDLE_NS = 5_000_000
"""The longest the lab is left behind the present: the truth of a quiet lab keeps coming, and the
work that has gathered stays small."""
_BACKLOG = 16
OUR_INTERFACE = "tonus"
"""A channel of any other python-can interface is bridged to it, where a node is emulated on it."""


class _Server:
    def __init__(
        self, lab: Lab, config: Config, directory: Path, utc: Callable[[], int] | None
    ) -> None:
        if config.lab is None:
            raise LabError(f"configuration {config.name} has no lab section")
        self._utc = utc
        self._end = config.lab.ethercat
        self._ports: list[SegmentPort] = []
        self._pairs: list[str] = []  # made here, and removed at the end
        self._lab = lab
        self._clock = lab.clock
        self._buses = config.fieldbus.parts
        self._relay = config.relay
        self._coalesce_ns = config.lab.bus.coalesce_us * 1000
        self._target = (config.tracker.address, config.tracker.port)
        self._loop = asyncio.get_running_loop()
        self._failed: asyncio.Future[None] = self._loop.create_future()
        self._listeners: dict[int, tuple[socket.socket, Path, Channel]] = {}
        self._knocks = select.poll()
        self._senders = select.poll()
        self._clients: list[Client] = []
        self._stalled: list[Client] = []
        self._left: list[Client] = []
        self._bridges: list[Bridge] = []
        self._door: DoorSocket | None = None
        self._tracker = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._tracker.setblocking(False)
        self._wake = WakeUp(self._loop, self._work)
        self._directory = directory
        self.unsound_frames = 0
        """frames no classic controller could have sent, thrown away"""

    async def run(self, ready: Callable[[], None]) -> None:
        self._loop.set_exception_handler(self._fail)
        self._open()
        self._work()
        ready()
        await self._failed

    def _open(self) -> None:
        try:
            self._directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise LabError(f"{self._directory} cannot be made: {error.strerror}") from error
        openers: dict[str, Callable[[Any], None]] = {
            "canopen": self._open_channels,
            "direct": lambda _: None,
            "ethercat": self._open_segment,
        }
        for bus in self._buses:
            if bus.kind not in openers:
                raise LabError(
                    f"fieldbus.kind {bus.kind}: the lab emulates it in virtual time only; add "
                    "--virtual"
                )
            openers[bus.kind](bus)
        relay = self._relay
        if relay is not None and relay.channel in self._lab.channels:
            self._open_channel(relay.channel, relay.interface, relay.bitrate)
        door = self._directory / LAB_DOOR
        remove_stale(door, socket.SOCK_DGRAM)
        self._door = DoorSocket(
            Door(self._lab), door, lambda: self._lab.advance(self._clock()), self._work
        )

    def _open_channels(self, bus: CanopenBus) -> None:
        for spec in bus.channels:
            self._open_channel(spec.name, bus.interface, bus.bitrate)

    def _open_channel(self, name: str, interface: str, bitrate: int) -> None:
        lab = self._lab
        channel = lab.channels[name]
        if interface == OUR_INTERFACE:
            self._listen(channel)
        elif any(name == inhabited for inhabited, _ in lab.nodes):
            self._bridges.append(Bridge(lab, channel, interface, bitrate, self._arm))

    def _open_segment(self, bus: EthercatBus) -> None:
        end = self._end
        assert end is not None  # or the lab would have no segment
        pairs = [(bus.interface, end.interface)]
        if bus.redundant_interface is not None:
            if end.redundant_interface is None:
                raise LabError(
                    "lab.ethercat.redundant_interface is missing: the fieldbus has a "
                    f"redundant_interface, {bus.redundant_interface}"
                )
            pairs.append((bus.redundant_interface, end.redundant_interface))
        for master, ours in pairs:
            if open_pair(master, ours):
                self._pairs.append(ours)
        interfaces = tuple(ours for _, ours in pairs)
        segment = self._lab.segments[bus.interface]
        self._ports.append(
            SegmentPort(segment, interfaces, end.receive_buffer, self._clock, self._utc, self._arm)
        )

    def _listen(self, channel: Channel) -> None:
        path = socket_path(self._directory, channel.name)
        remove_stale(path)
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        listener.setblocking(False)
        try:
            listener.bind(str(path))
        except OSError as error:
            listener.close()
            raise LabError(f"{path} cannot be opened: {error}") from error
        self._listeners[listener.fileno()] = listener, path, channel
        listener.listen(_BACKLOG)
        self._knocks.register(listener, select.POLLIN)
        self._loop.add_reader(listener, self._accept)

    def close(self) -> None:
        self._loop.set_exception_handler(None)
        self._wake.close()
        if self._door is not None:
            self._door.close()
        for listener, path, _ in self._listeners.values():
            self._loop.remove_reader(listener)
            listener.close()
            path.unlink(missing_ok=True)
        for client in tuple(self._clients):
            self._leave(client)
        for bridge in self._bridges:
            bridge.close()
        for port in self._ports:
            port.close()
        for ours in self._pairs:
            close_pair(ours)
        self._tracker.close()

    def _accept(self) -> None:
        """Attach all who have connected, where the lab is: what others sent since is for them, too,
        and may not have been read yet."""
        for descriptor, _ in self._knocks.poll(0):
            listener, _, channel = self._listeners[descriptor]
            with suppress(BlockingIOError):
                while True:
                    connection, _ = listener.accept()
                    connection.setblocking(False)
                    client = Client(connection, channel)
                    self._clients.append(client)
                    self._senders.register(connection, select.POLLIN)
                    self._loop.add_reader(connection, self._receive, client)

    def _leave(self, client: Client) -> None:
        self._loop.remove_reader(client.connection)
        self._senders.unregister(client.connection)
        client.connection.close()
        client.leave()
        self._clients.remove(client)
        if client in self._stalled:
            self._stalled.remove(client)

    def _receive(self, client: Client) -> None:
        """Take what a client has sent. A frame that tells when it was sent enters its queue then,
        unless the lab is past that: how late it is read must not show on the bus. The lab is left
        there, since another channel's frame may be of the same time."""
        frames = self._read(client)
        if frames and self._clock() - frames[0].sent_ns > self._coalesce_ns:
            # We are late: the others' frames are older than the last of these.
            frames += self._read_all(client)
        self._queue(frames)
        self._arm()

    def _read_all(self, but: Client | None = None) -> list[Sent | SentTogether]:
        self._accept()
        frames: list[Sent | SentTogether] = []
        # One call for all: most have sent nothing, and to be refused by each costs more.
        ready = {descriptor for descriptor, _ in self._senders.poll(0)}
        for client in tuple(self._clients):
            if client is but or client in self._stalled:
                continue
            if client.waiting or client.connection.fileno() in ready:
                frames += self._read(client)
        return frames

    def _read(self, client: Client) -> list[Sent | SentTogether]:
        """What a client has sent, as far as its queue has room; the rest waits in its socket, where
        its own next send will find it full."""
        carrier = client.carrier
        if client.room <= len(client.waiting):
            self._lab.advance(self._clock())
        room, room_of_carrier = client.room - len(client.waiting), carrier.room
        waiting: list[Sent | SentTogether] = [*client.take_waiting()]
        last_ns = max(map(sent_ns, waiting), default=0)
        frames = self._received(client, room, last_ns)
        if carrier is not client:
            # What came by that was sent before.
            frames = self._received(carrier, room_of_carrier, last_ns) + frames
        return waiting + frames

    def _received(self, client: Client, room: int, last_ns: int) -> list[Sent | SentTogether]:
        """What has come by its connection after ``last_ns``, as far as there is ``room``."""
        frames: list[Sent | SentTogether] = []
        try:
            while room > 0:
                packet = client.connection.recv(PACKET_BYTES)
                now_ns = self._clock()
                if not packet:
                    self._has_left(client)
                    return frames
                for sent in client.sent(packet, now_ns, last_ns):
                    frames.append(sent)
                    room -= 1 if isinstance(sent, Sent) else sent.most
                    last_ns = sent.sent_ns
        except BlockingIOError:
            return frames
        except OSError:
            self._has_left(client)
            return frames
        self._loop.remove_reader(client.connection)
        if client not in self._stalled:
            self._stalled.append(client)
        return frames

    def _has_left(self, client: Client) -> None:
        if client not in self._left:
            self._left.append(client)

    def _queue(self, frames: list[Sent | SentTogether]) -> None:
        """Let the lab have frames, each at its time."""
        lab = self._lab
        for sent in sorted(frames, key=sent_ns):
            lab.simulate(sent.sent_ns)
            if isinstance(sent, Sent):
                self._queue_one(sent)
                continue
            joined = None if sent.client.waits else sent.client.joined
            if joined is None or not joined.send_joined(sent.frames, lab.now_ns):
                for each in apart(sent):
                    self._queue_one(each)
        left, self._left = self._left, []
        for client in left:
            if client.port.waiting or client.carrier in self._stalled:
                # Its socket is found closed again when they are sent: closing takes nothing back.
                self._loop.remove_reader(client.connection)
            else:
                self._leave(client)

    def _queue_one(self, sent: Sent) -> None:
        port, now_ns = sent.client.port, self._lab.now_ns
        if sent.identifier == WISHES:
            sent.client.wish(Wishes.of(sent.data), self._clients, self._lab)
        elif not sound(sent.identifier, sent.dlc):
            self.unsound_frames += 1
        elif port.room > 0 and not sent.client.waiting:
            port.channel.send(port, Frame(sent.identifier, sent.data, sent.dlc), now_ns)
        else:
            sent.client.wait(sent)

    def _fail(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """An error in a callback ends the serving; the loop would only log it."""
        error = context.get("exception")
        if isinstance(error, Exception) and not self._failed.done():
            self._failed.set_exception(error)
        else:
            loop.default_exception_handler(context)

    def _work(self) -> None:
        """Bring the lab to the present and hand out what came of it."""
        lab = self._lab
        now_ns = self._clock()
        # What was sent before this instant first, or the lab would be past it.
        for port in self._ports:
            port.receive_all()
        self._queue(self._read_all())
        lab.advance(now_ns)
        for port in self._ports:
            port.receive_all()  # what came meanwhile has waited enough
        for client in tuple(self._clients):
            if client.carrier is not client or not client.received:
                continue
            if now_ns - client.sent_ns >= client.gather_ns:
                client.sent_ns = now_ns
                self._send(client)
        for bridge in self._bridges:
            bridge.forward()
        for datagram in lab.tracker.poll(now_ns):
            try:
                self._tracker.sendto(datagram, self._target)
            except OSError:
                # Nobody listens, or the way is full: a datagram may get lost.
                continue
        for client in tuple(self._stalled):
            # It may have left since: one that leaves has its carrier read too.
            if client in self._stalled and client.room > 0:
                self._stalled.remove(client)
                self._loop.add_reader(client.connection, self._receive, client)
                self._queue(self._read(client))
        self._arm()

    def _send(self, client: Client) -> None:
        data = client.take()
        try:
            while data:
                client.connection.send(data[:PACKET_BYTES])
                data = data[PACKET_BYTES:]
        except BlockingIOError:
            # As a controller's receive buffer that nobody empties.
            client.missed(data)
        except OSError:
            if not client.port.waiting:
                self._leave(client)

    def _arm(self) -> None:
        lab = self._lab
        due_ns = min(lab.next_event_ns() + self._coalesce_ns, lab.now_ns + _IDLE_NS)
        if self._ports:
            # A frame waits for what is due before it, so that is not left until one comes.
            due_ns = min(due_ns, lab.next_work_ns())
        wake = self._wake
        # What is due first is kept: later frames are taken along with it.
        if not wake.due_ns or due_ns < wake.due_ns:
            wake.at(due_ns)


async def serve(
    lab: Lab,
    config: Config,
    runtime_dir: Path,
    ready: Callable[[], None],
    utc: Callable[[], int] | None = None,
) -> None:
    """Serve until cancelled; ``ready`` is called when clients can connect.

    The lab's clock has to be CLOCK_MONOTONIC in ns, as the running loop's is; ``utc`` tells what to
    add to it for UTC, by which the kernel stamps frames of EtherCAT. Raises `LabError`.
    """
    lab.measure_latency()
    rehearse()
    server = _Server(lab, config, runtime_dir, utc)
    try:
        await server.run(ready)
    finally:
        server.close()
