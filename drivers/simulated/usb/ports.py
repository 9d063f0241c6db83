"""Where simulated USB devices are plugged in, and the handles that a program holds on them."""

from dataclasses import dataclass
from typing import Protocol

from nlos.drivers.simulated.faults import FaultPlan
from nlos.drivers.simulated.usb.descriptors import UsbDescription
from nlos.drivers.simulated.usb.usbtmc_device import Instrument, UsbtmcDevice


class UsbInstrument(Instrument, Protocol):
    """A firmware that can be plugged in."""

    @property
    def usb(self) -> UsbDescription:
        """What its descriptors say."""
        ...

    @property
    def faults(self) -> FaultPlan:
        """What it is going to do wrong."""
        ...


@dataclass(eq=False)
class UsbPort:
    number: int
    device: UsbtmcDevice
    usb: UsbDescription
    faults: FaultPlan
    address: int
    plugged: bool = True
    claimed_by: object | None = None
    kernel_driver: bool = False
    replug_s: float | None = None


@dataclass(eq=False)
class UsbHandle:
    port: UsbPort
    address: int
