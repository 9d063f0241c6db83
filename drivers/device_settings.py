"""What the block of a bench file says of any device, whatever its model: its word, and where it is plugged in."""

from typing import ClassVar, Literal, Self

from nlos.configs.settings import Settings

Cable = Literal["serial", "usb", "library"]
"""A serial port, a USB device that this program talks to itself, or a vendor's library that talks to it."""

ADDRESS_KEYS: dict[Cable, str] = {"serial": "port", "usb": "usb", "library": "library"}
"""Cable -> the key of a block that says where it is plugged in."""


class DeviceSettings(Settings):
    """A model's own block derives from `MirrorBlock` or `CounterBlock`, narrows `model` to `Literal["its word"]`, and
    has the key that its `cable` calls for: `port`, `usb` or `library`."""

    cable: ClassVar[Cable]
    incidental: ClassVar[frozenset[str]] = frozenset(ADDRESS_KEYS.values()) | {"serial", "timeout_s"}
    """Keys that do not matter to what is counted where: a scan may be resumed with others. A model adds its own."""

    model: str
    """Which driver: the word by which a bench file names this kind of device."""

    @property
    def address(self) -> str:
        """Where it is plugged in, as the bench file says."""
        return str(getattr(self, ADDRESS_KEYS[self.cable]))

    @property
    def simulated(self) -> bool:
        """Whether its address means the simulated device."""
        return self.address == "simulated" or self.address.startswith("sim://")

    def on_simulated_cable(self) -> Self:
        """The same device with a simulated one at the other end."""
        address = f"sim://{self.model}" if self.cable == "serial" else "simulated"
        return self.model_copy(update={ADDRESS_KEYS[self.cable]: address})

    @property
    def udev_rule(self) -> str:
        """The line that lets the person at a Linux computer open it; empty where it needs none of ours."""
        return ""
