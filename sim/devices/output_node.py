"""An emulated CiA 401 node with one group of digital outputs and one of digital inputs.

When its bus reports an error (a heartbeat that ended among them), or it leaves NMT operational, an
output with an error mode takes its error value, and stays there until process data set it again.
"""

from __future__ import annotations

from collections.abc import Callable

from tonus.sim.devices.device import ErrorSink, PdoDefault, Reader, Writer
from tonus.sim.devices.objects import Entry, Kind, ObjectDictionary
from tonus.sim.devices.store import connect_store

DEVICE_TYPE = 0x00030191
"""CiA 401, digital inputs and outputs"""
VENDOR, PRODUCT, REVISION = 0x0000FFFF, 0x00000191, 0x00000001
_OUTPUT, _MODE, _ERROR_VALUE, _INPUT = 0x6200, 0x6206, 0x6207, 0x6000
_GROUP = 1
_ALL = 0xFF
_EVENT = 255
_COMMUNICATION_ERROR = 0x10
"""error register"""
_VALID_NO_REMOTE = 0x40000000


def _no_sink(code: int, register: int) -> None:
    del code, register


class OutputNode:
    """``switched`` is called with the outputs, a bit each, when they change; `inputs` are set by
    whoever is wired to them."""

    axis: int | None = None
    longest_mapping = 8
    consumers = 1
    event_timer = True
    error_behaviour = True
    receive_pdos = (PdoDefault(0x200, _EVENT, (_OUTPUT << 16 | _GROUP << 8 | 8,)),)
    transmit_pdos = (
        PdoDefault(_VALID_NO_REMOTE | 0x180, _EVENT, (_INPUT << 16 | _GROUP << 8 | 8,)),
    )

    def __init__(self, node_id: int, switched: Callable[[int], None]) -> None:
        self.on_error: ErrorSink = _no_sink
        self.inputs = 0
        self.outputs = 0
        """at the terminals"""
        self._switched = switched
        self.objects = self._dictionary(node_id)

    def _dictionary(self, node_id: int) -> ObjectDictionary:
        objects = ObjectDictionary()
        add = objects.add
        add(0x1000, 0, Entry("Device type", Kind.U32, "ro", DEVICE_TYPE))
        add(0x1001, 0, Entry("Error register", Kind.U8, "ro", 0))
        objects.names |= {
            0x1010: "Store parameters",
            0x1011: "Restore default parameters",
            0x1018: "Identity object",
        }
        add(0x1010, 1, Entry("Save all parameters", Kind.U32, "rw", 1))
        add(0x1011, 1, Entry("Restore all default parameters", Kind.U32, "rw", 1))
        connect_store(objects)
        add(0x1018, 1, Entry("Vendor-ID", Kind.U32, "ro", VENDOR))
        add(0x1018, 2, Entry("Product code", Kind.U32, "ro", PRODUCT))
        add(0x1018, 3, Entry("Revision number", Kind.U32, "ro", REVISION))
        add(0x1018, 4, Entry("Serial number", Kind.U32, "ro", node_id))
        read = add(_INPUT, _GROUP, Entry("Read inputs 1 to 8", Kind.U8, "ro", 0, mapping="t"))
        read.read = lambda: self.inputs
        write = add(_OUTPUT, _GROUP, Entry("Write outputs 1 to 8", Kind.U8, "rw", 0, mapping="r"))
        write.write = self._put
        write.read = lambda: self.outputs
        write.lasting = False
        # CiA 401: as from the factory every output has an error mode, and 0 is its error value.
        add(_MODE, _GROUP, Entry("Error mode outputs 1 to 8", Kind.U8, "rw", _ALL))
        add(_ERROR_VALUE, _GROUP, Entry("Error value outputs 1 to 8", Kind.U8, "rw", 0))
        return objects

    def _put(self, outputs: int) -> None:
        if outputs != self.outputs:
            self.outputs = outputs
            self._switched(outputs)

    def _to_error_values(self) -> None:
        mode = self.objects.number(_MODE, _GROUP)
        value = self.objects.number(_ERROR_VALUE, _GROUP)
        self._put(self.outputs & ~mode | value & mode)

    # -- process data ----------------------------------------------------------------------------

    def sample(self, now_ns: int) -> None:
        """The inputs are what they are."""

    def reader(self, index: int, subindex: int) -> Reader:
        return self.objects.find(index, subindex).measure

    def place(self, index: int, subindex: int) -> int | None:
        """Nothing of it stands in the samples."""

    def writer(self, index: int, subindex: int) -> Writer:
        return self.objects.find(index, subindex).put

    def received(self, now_ns: int) -> None:
        """Outputs switch as they are written."""

    # -- state -----------------------------------------------------------------------------------

    def set_operational(self, operational: bool) -> None:
        if not operational:
            self._to_error_values()

    def fail(self, code: int) -> None:
        register = self.objects.number(0x1001, 0) | _COMMUNICATION_ERROR
        self.objects.find(0x1001, 0).value = register
        self._to_error_values()
        self.on_error(code, register)

    def communication_reset(self) -> None:
        """Its error is over with the communication that had it."""
        self.objects.find(0x1001, 0).value = 0

    def reset(self) -> None:
        self._put(0)
        self.objects.restore(0x2000, 0xFFFF)

    def power_cycle(self) -> None:
        """The supply goes and comes back."""
        self.objects.restore(0x1000, 0x1FFF)
        self.reset()
