"""The tree of device errors: every way in which a cable, a controller or a counter can fail has one name here."""

import copyreg


class DeviceError(Exception):
    """Something went wrong with a device.

    `device` names it as the bench file does, `what` says what happened and with what, `remedy` what to do next: where
    nothing better is known, what usually helps against errors of that kind.
    """

    usual_remedy = "Open the bench again."

    def __init__(self, device: str, what: str, remedy: str = "") -> None:
        self.device = device
        super().__init__()
        self.say(what, remedy or self.usual_remedy)

    def say(self, what: str, remedy: str) -> None:
        """The same error in other words."""
        self.what, self.remedy = what, remedy
        self.args = (f"{self.device}: {what} {remedy}".rstrip(),)

    @property
    def said(self) -> str:
        """What happened, and with which device; what to do next is not in it."""
        return f"{self.device}: {self.what}"

    def __reduce__(self) -> tuple[object, ...]:
        """Copied as it is, between processes, too: a pool whose worker sends what cannot be read waits for ever."""
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]


class DeviceNotFound(DeviceError):
    """No such port, USB device or vendor library."""


class DeviceBusy(DeviceError):
    """Another program holds the device, or this user may not open it."""


class WrongDevice(DeviceError):
    """Something answers, but it is not what the bench file names."""


class DeviceTimeout(DeviceError):
    """No complete answer within the deadline."""

    usual_remedy = "Check its cable and power, then open the bench again."


class SettleTimeout(DeviceTimeout):
    """The mirror did not report a stable position within the deadline. It is not moved again."""


class Preempted(DeviceTimeout):
    """The command that shuts the light broke into this exchange, whose answer is lost. The device is well."""


class DeviceLost(DeviceError):
    """The cable was pulled, or the device left the bus."""

    usual_remedy = "Check its cable and power, then open the bench again."


class DeviceReset(DeviceError):
    """The device restarted on its own: its state is no longer what was set."""

    usual_remedy = "Check its supply, then open the bench again."


class MirrorDisturbed(DeviceError):
    """Somebody else moved the mirror. It does not move until `park`, in the dark, has put it right."""


class DeviceFault(DeviceError):
    """The device itself reports a fault (temperature, current, position sensor)."""


class ProtocolError(DeviceError):
    """Bytes arrived that the protocol does not allow. What they meant is not guessed."""

    usual_remedy = "Check its cable, then open the bench again; --wire-log keeps every byte for a report."


class DataCorrupt(ProtocolError):
    """A data record failed its checksum, length or index."""


class CommandRejected(DeviceError):
    """The device understood the command and refused it."""

    usual_remedy = "Open the bench again; --wire-log keeps every byte for a report."


class LimitError(DeviceError):
    """A position, rate or setting outside its allowed range. Nothing was sent, nothing moved."""

    usual_remedy = "Correct the scan or bench file."


class BenchClosed(DeviceError):
    """The bench was closed meanwhile: nothing on it can be asked for any more."""

    usual_remedy = "Open the bench again and begin a new scan."


class ShutterHeld(DeviceError):
    """A signal shut the light off: it stays off until a scan is begun or resumed."""

    usual_remedy = "Start a new scan, or continue the paused one."


class SafetyTrip(DeviceError):
    """The light was shut off: over-count, open interlock or watchdog. Clearing it is a person's decision."""

    usual_remedy = "Find the cause before anything is switched on again."


class SyncLost(SafetyTrip):
    """The laser's synchronisation signal is missing."""
