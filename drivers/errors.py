"""What can go wrong between control and a device."""

from __future__ import annotations


class DriverError(Exception):
    """A device or a bus did not do what the daemon needs."""


class BringUpError(DriverError):
    """One or more devices could not be brought to operation; the text names each and why."""


class SdoError(DriverError):
    """An object access failed."""


class SdoAbortError(SdoError):
    """The device refused, with a CiA 301 abort code."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(f"abort 0x{code:08X}: {text}")
        self.code = code


class SdoTimeoutError(SdoError):
    """The device did not answer in time."""
