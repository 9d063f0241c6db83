"""The tree of device errors: every way in which a cable, a controller or a counter can fail has one name here."""


class DeviceError(Exception):
    """Something went wrong with a device.

    `device` names it as the bench file does, `what` says what happened and with what, `remedy` what to do next.
    """

    def __init__(self, device: str, what: str, remedy: str = "") -> None:
        self.device = device
        self.what = what
        self.remedy = remedy
        super().__init__(f"{device}: {what}" + (f" {remedy}" if remedy else ""))


class DeviceNotFound(DeviceError):
    """No such port, USB device or vendor library."""


class DeviceBusy(DeviceError):
    """Another program holds the device, or this user may not open it."""


class WrongDevice(DeviceError):
    """Something answers, but it is not what the bench file names."""


class DeviceTimeout(DeviceError):
    """No complete answer within the deadline."""


class SettleTimeout(DeviceTimeout):
    """The mirror did not report a stable position within the deadline. It is not moved again."""


class DeviceLost(DeviceError):
    """The cable was pulled, or the device left the bus."""


class DeviceReset(DeviceError):
    """The device restarted on its own: its state is no longer what was set."""


class DeviceFault(DeviceError):
    """The device itself reports a fault (temperature, current, position sensor)."""


class ProtocolError(DeviceError):
    """Bytes arrived that the protocol does not allow. What they meant is not guessed."""


class DataCorrupt(ProtocolError):
    """A data record failed its checksum, length or index."""


class CommandRejected(DeviceError):
    """The device understood the command and refused it."""


class LimitError(DeviceError):
    """A position, rate or setting outside its allowed range. Nothing was sent, nothing moved."""


class DataLoss(DeviceError):
    """Photons were lost in the device (FIFO full, slot overrun). What arrived is kept and flagged."""


class SafetyTrip(DeviceError):
    """The light was shut off: over-count, open interlock or watchdog. Clearing it is a person's decision."""


class SyncLost(SafetyTrip):
    """The laser's synchronisation signal is missing."""
