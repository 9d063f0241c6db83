"""What pyusb's errors mean: by their type, libusb's code, or errno."""

import errno
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import usb.core

from nlos.drivers.errors import DeviceBusy, DeviceError, DeviceLost, DeviceTimeout, ProtocolError

# libusb error codes, the same on every platform; errno differs between them.
_LIBUSB_ACCESS, _LIBUSB_NO_DEVICE, _LIBUSB_BUSY = -3, -4, -6
_LIBUSB_TIMEOUT, _LIBUSB_OVERFLOW, _LIBUSB_PIPE, _LIBUSB_IO = -7, -8, -9, -1
_CODE_OF_ERRNO = {
    errno.EACCES: _LIBUSB_ACCESS,
    errno.EPERM: _LIBUSB_ACCESS,
    errno.ENODEV: _LIBUSB_NO_DEVICE,
    errno.EBUSY: _LIBUSB_BUSY,
    errno.ETIMEDOUT: _LIBUSB_TIMEOUT,
    errno.EOVERFLOW: _LIBUSB_OVERFLOW,
    errno.EPIPE: _LIBUSB_PIPE,
    errno.EIO: _LIBUSB_IO,
}


class PipeHalted(ProtocolError):
    """The device stalled a pipe or a control request."""


class Overflow(ProtocolError):
    """The device sent more than was asked for; what it sent is lost."""


def classify(device: str, doing: str, error: usb.core.USBError) -> DeviceError:
    """The `DeviceError` that `error` means: by its type, then libusb's code, then errno."""
    code = error.backend_error_code
    if isinstance(error, usb.core.USBTimeoutError):
        code = _LIBUSB_TIMEOUT
    elif code is None:
        code = _CODE_OF_ERRNO.get(error.errno or 0)
    if code == _LIBUSB_TIMEOUT:
        return DeviceTimeout(device, f"no answer while {doing}.")
    if code == _LIBUSB_PIPE:
        return PipeHalted(device, f"the device refused (stall) while {doing}.")
    if code == _LIBUSB_OVERFLOW:
        return Overflow(device, f"the device sent more than was asked for while {doing}.")
    if code == _LIBUSB_ACCESS:
        return DeviceBusy(
            device,
            f"this user may not open the USB device (while {doing}).",
            "On Linux, add the udev rule that `nlos devices --bench BENCH` prints, and plug it in again.",
        )
    if code == _LIBUSB_BUSY:
        return DeviceBusy(device, f"another program holds the USB device (while {doing}).", "Close that program.")
    return DeviceLost(
        device, f"the USB device is gone ({error}) while {doing}.", "Check cable and power, then open it again."
    )


@contextmanager
def closed_unless_opened(device: str, close: Callable[[], None]) -> Iterator[None]:
    """Claims pipes of a device that is closed again where that fails. Raises `DeviceError`s only."""
    try:
        yield
    except usb.core.USBError as error:
        close()
        raise classify(device, "opening it", error) from error
    except DeviceError:
        close()
        raise
