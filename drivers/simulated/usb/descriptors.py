"""The USB descriptors of a simulated USBTMC-USB488 device, with the fields that pyusb reads."""

from dataclasses import dataclass
from types import SimpleNamespace


@dataclass(frozen=True)
class UsbDescription:
    """Ids, texts and packet size of one device."""

    vendor_id: int
    product_id: int
    manufacturer: str
    product: str
    serial: str
    packet_bytes: int = 512


def device_descriptor(usb: UsbDescription, address: int, port: int) -> SimpleNamespace:
    """USB 2.0, table 9-8."""
    return SimpleNamespace(
        bLength=18, bDescriptorType=1, bcdUSB=0x0200, bDeviceClass=0, bDeviceSubClass=0, bDeviceProtocol=0,
        bMaxPacketSize0=64, idVendor=usb.vendor_id, idProduct=usb.product_id, bcdDevice=0x0100,
        iManufacturer=1, iProduct=2, iSerialNumber=3, bNumConfigurations=1,
        address=address, bus=1, port_number=port, port_numbers=(port,), speed=3,
    )  # fmt: skip


def configuration_descriptor(index: int, total_bytes: int = 39, most_ma: int = 100) -> SimpleNamespace:
    """USB 2.0, table 9-10: one interface."""
    if index != 0:
        raise IndexError(f"no configuration {index}")
    return SimpleNamespace(
        bLength=9, bDescriptorType=2, wTotalLength=total_bytes, bNumInterfaces=1, bConfigurationValue=1,
        iConfiguration=0, bmAttributes=0x80, bMaxPower=most_ma // 2, extra_descriptors=[],
    )  # fmt: skip


def interface_descriptor(index: int, alternate: int) -> SimpleNamespace:
    """IndexError past the end is how pyusb counts interfaces."""
    if index != 0 or alternate != 0:
        raise IndexError(f"no interface {index}, {alternate}")
    return SimpleNamespace(
        bLength=9, bDescriptorType=4, bInterfaceNumber=0, bAlternateSetting=0, bNumEndpoints=3,
        bInterfaceClass=0xFE, bInterfaceSubClass=3, bInterfaceProtocol=1, iInterface=0, extra_descriptors=[],
    )  # fmt: skip


def endpoint_descriptor(usb: UsbDescription, index: int) -> SimpleNamespace:
    """Bulk-OUT, Bulk-IN and Interrupt-IN; IndexError past the end."""
    address, kind, packet = [(0x01, 2, usb.packet_bytes), (0x82, 2, usb.packet_bytes), (0x83, 3, 8)][index]
    return SimpleNamespace(
        bLength=7, bDescriptorType=5, bEndpointAddress=address, bmAttributes=kind, wMaxPacketSize=packet,
        bInterval=1, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
    )  # fmt: skip


def string_descriptor(usb: UsbDescription, value: int) -> bytes | None:
    """The answer to GET_DESCRIPTOR(string); None where there is no such string."""
    if value == 0x0300:
        return bytes([4, 3, 0x09, 0x04])
    texts = {0x0301: usb.manufacturer, 0x0302: usb.product, 0x0303: usb.serial}
    if value not in texts:
        return None
    text = texts[value].encode("utf-16-le")
    return bytes([2 + len(text), 3]) + text
