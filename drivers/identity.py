"""Who a device says it is: what a recording keeps and what a bench file may insist on."""

from dataclasses import dataclass


@dataclass(frozen=True)
class DeviceIdentity:
    """Model word of the bench file, and what the device answered when asked."""

    model: str
    vendor: str
    product: str
    serial: str
    firmware: str

    @property
    def name(self) -> str:
        """Model and serial number, as files name a device."""
        return f"{self.model} {self.serial}".strip()

    def __str__(self) -> str:
        named = (
            f"{self.vendor} {self.product}, serial {self.serial or 'unknown'}, firmware {self.firmware or 'unknown'}"
        )
        return named.strip()
