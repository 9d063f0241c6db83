"""What one model of mirror controller or counter brings with it: all that the rest of the program has to be told."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from nlos.drivers.clock import Clock
from nlos.drivers.device_settings import DeviceSettings
from nlos.drivers.presence import Presence
from nlos.drivers.shutter import LaserShutter
from nlos.drivers.simulated.fault_row import FaultRow

if TYPE_CHECKING:
    from nlos.drivers.simulated.table import SimulatedTable

Device = TypeVar("Device")
WireLog = Callable[[str, str, bytes], None]
"""(device, ">" sent or "<" received, bytes)"""


@dataclass(frozen=True)
class ShutterOutput:
    """An output that is wired to a laser shutter. `needs`: the key of the device's block that must be set for it."""

    of: Callable[[Any], LaserShutter]
    """The open device -> its shutter."""
    needs: str = ""


@dataclass(frozen=True)
class DeviceModel(Generic[Device]):
    """A model is found by the registry (`drivers/galvo/known_mirrors.py`, `drivers/tcspc/known_counters.py`) or, in a
    package of its own, by an entry point in the group `nlos.mirrors` or `nlos.counters` that names an object of this
    class."""

    settings: type[DeviceSettings]
    """Its block in a bench file; what `model` says there is the word by which it is known."""
    open: Callable[[Any, Clock, Any, WireLog | None], Device]
    """(settings, clock, backend, wire log) -> the open device. `backend` is what replaces libusb or the vendor's
    library; None: the real one. Raises `DeviceError`. A mirror controller that drives the shutter closes it before
    it does anything else."""
    firmware: "Callable[[Any, SimulatedTable], Any]"
    """(settings, simulated table) -> the other end of the cable: a `SerialFirmware`, a simulated
    USBTMC instrument, or what replaces libusb or the vendor's library, as the settings' `cable` says."""
    look_for: Callable[[Any], Presence]
    """Settings -> whether it is plugged in. Opens nothing."""
    faults: Sequence[FaultRow] = ()
    """What its firmware can do wrong when a bench file asks for it, beside the faults of a serial line."""
    pulled: str = "G8"
    """Which fault is its cable pulled: a serial line's, or one of its own."""
    shutters: Mapping[str, ShutterOutput] = field(default_factory=dict)
    """Word in a bench file's `shutter` block -> the output of this device that it means."""

    @property
    def name(self) -> str:
        """The word in a bench file."""
        (word,) = self.settings.model_fields["model"].annotation.__args__  # type: ignore[union-attr]
        return str(word)
