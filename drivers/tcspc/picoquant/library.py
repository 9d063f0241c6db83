"""The vendor's library behind one door: every call checked, every error code named, nothing repeated that may not be.

The library is not thread-safe (MHLib manual 7.2.4): one lock is held over each call.
"""

import ctypes
import logging
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any

from nlos.drivers.clock import Clock
from nlos.drivers.errors import (
    CommandRejected,
    DeviceBusy,
    DeviceError,
    DeviceFault,
    DeviceLost,
    DeviceNotFound,
    DeviceTimeout,
    LimitError,
    WrongDevice,
)
from nlos.drivers.link.repeats import repeated
from nlos.drivers.tcspc.picoquant.families import Family

_log = logging.getLogger(__name__)

WireLog = Callable[[str, str, bytes], None]

_RETRY_AFTER_S = 0.1
_CLOSES_WITHIN_S = 5.0
_TEXT_BYTES = 64
"""The libraries write without asking for how much there is room: 40 bytes at most, 32 of a serial number."""
_INSTRUMENTS = 8
"""MAXDEVNUM of every family's header file."""
_TRANSIENT = (-36, -37)
"""USB_VCMD_FAIL and USB_BULKRD_FAIL come at random on some computers and are gone 100 ms later (known from PHLib)."""
_NEVER_TWICE = frozenset(("StartMeas", "ReadFiFo", "OpenDevice", "Initialize", "ClearHistMem"))
"""Calls whose second time is not the same as their first."""

_ERRORS: dict[int, type[DeviceError]] = {
    -1: DeviceNotFound,
    -2: DeviceBusy,
    -10: DeviceLost,
    -11: DeviceBusy,
    -16: CommandRejected,
    -17: LimitError,
    -18: CommandRejected,
    -20: DeviceLost,
    -22: CommandRejected,
    -23: CommandRejected,
    -28: DeviceFault,
}
_REMEDIES: dict[int, str] = {
    -2: "Close the program that uses it.",
    -10: "Check its cable and power, then open the bench again.",
    -11: "Close the program that uses it.",
    -16: "Stop the measurement first.",
    -20: "Open the bench again: this instrument is not open.",
    -28: "Switch the instrument off and on.",
}


class VendorLibrary:
    """Calls by their names without prefix, for one instrument once `index` is set."""

    def __init__(
        self, device: str, family: Family, functions: Any, clock: Clock, wire_log: WireLog | None = None
    ) -> None:
        self.device, self.family, self.index = device, family, 0
        self._functions, self._clock, self._wire_log = functions, clock, wire_log
        self._lock = threading.RLock()
        version = self.text("GetLibraryVersion", _TEXT_BYTES)
        if version.partition(".")[0] not in family.library_versions:
            raise WrongDevice(
                device,
                f"the library says it is version {version!r}; this adapter is written for version "
                f"{' and '.join(family.library_versions)}.",
                f"Install {family.package}, from the vendor's web site.",
            )

    def call(self, name: str, *arguments: Any) -> int:
        """Calls PREFIX_name(index, *arguments). Raises the `DeviceError` that the return code means."""
        code = self.attempt(name, self.index, *arguments)
        if code in _TRANSIENT and name not in _NEVER_TWICE:
            repeated(self.device, f"{name} failed with {code}")
            self._clock.sleep(_RETRY_AFTER_S)
            code = self.attempt(name, self.index, *arguments)
        if code < 0:
            raise self.error(name, code)
        return code

    def attempt(self, name: str, *arguments: Any) -> int:
        """Calls PREFIX_name(*arguments) once and returns its code."""
        full = f"{self.family.prefix}_{name}"
        function = getattr(self._functions, full, None)
        if function is None:
            raise WrongDevice(
                self.device,
                f"the library has no {full}: it is another one, or of another version than it says.",
                f"Install {self.family.package}, from the vendor's web site.",
            )
        with self._lock:
            if self._wire_log:
                self._wire_log(self.device, ">", f"{full}{_shown(arguments)}".encode())
            code = int(function(*arguments))
            if self._wire_log:
                self._wire_log(self.device, "<", f"{code} {_shown(arguments)}".encode())
        return code

    def let_go(self) -> None:
        """CloseDevice, which comes last, when it is dark: one that never returns is left to itself, and said."""
        closing = threading.Thread(target=self.attempt, args=("CloseDevice", self.index), daemon=True)
        closing.start()
        closing.join(_CLOSES_WITHIN_S)
        if closing.is_alive():
            _log.warning("%s: %s_CloseDevice hangs and is waited for no more.", self.device, self.family.prefix)

    def integer(self, name: str, *arguments: Any) -> int:
        """The int that the call writes to its last argument."""
        value = ctypes.c_int()
        self.call(name, *arguments, ctypes.byref(value))
        return value.value

    def real(self, name: str) -> float:
        """The double that the call writes to its last argument."""
        value = ctypes.c_double()
        self.call(name, ctypes.byref(value))
        return value.value

    def text(self, name: str, size: int, *arguments: Any) -> str:
        """The string that a call without instrument writes to its first argument."""
        buffer = ctypes.create_string_buffer(size)
        code = self.attempt(name, buffer, *arguments)
        return buffer.value.decode("ascii", "replace") if code >= 0 else f"error {code}"

    def error(self, name: str, code: int) -> DeviceError:
        """The exception for a return code, with the library's own words."""
        words = self.text("GetErrorString", _TEXT_BYTES, code)
        kind = _ERRORS.get(code, DeviceLost if -38 <= code <= -32 else DeviceFault)
        remedy = _REMEDIES.get(code, "Check its USB cable, then open the bench again." if kind is DeviceLost else "")
        return kind(self.device, f"{self.family.prefix}_{name} failed: {words} ({code}).", remedy)


def _shown(arguments: Sequence[Any]) -> str:
    """Arguments as they stand, those that a call writes to included; of arrays only that they are there."""
    held = [getattr(each, "_obj", each) for each in arguments]
    return f"({', '.join(str(each if isinstance(each, int) else getattr(each, 'value', '...')) for each in held)})"


def load_library(device: str, family: Family, where: str) -> Any:
    """The shared library with its functions, from `where` or, for "vendor", from the loader's search path.

    Raises `DeviceNotFound` that says what to install and where it then is.
    """
    windows = sys.platform == "win32"
    name = (family.windows_library if windows else family.linux_library) if where == "vendor" else where
    load = getattr(ctypes, "WinDLL", ctypes.CDLL) if windows else ctypes.CDLL
    try:
        return load(name)
    except OSError as error:
        usual = "C:\\Windows\\System32" if windows else "/usr/lib or /usr/local/lib, as its install script does"
        raise DeviceNotFound(
            device,
            f"the vendor's library {name} could not be loaded ({error}).",
            f"Install {family.package} for this system from the vendor's web site; {name} belongs in {usual}. "
            "Or name its path as `library` in the bench file.",
        ) from error


def open_instrument(library: VendorLibrary, serial: str) -> str:
    """Opens the instrument of that serial number, or the only one that answers ("auto"); returns its serial number.

    Raises `DeviceNotFound`, `DeviceBusy`, or what the library reports. Which of several has the lowest index may change
    with the next plug.
    """
    answering, codes = {}, []
    for index in range(_INSTRUMENTS):
        buffer = ctypes.create_string_buffer(_TEXT_BYTES)
        code = library.attempt("OpenDevice", index, buffer)
        if code == 0:
            found = _named(library, index, buffer)
            answering[index] = found
            if found == serial:
                break
        elif code != -1:
            codes.append(code)
    chosen = [index for index, found in answering.items() if serial in ("auto", found)]
    unsure = bool(codes) and serial == "auto"  # what is in use may be the one that is meant
    for index in answering:
        if [index] != chosen or unsure:
            library.attempt("CloseDevice", index)
    if len(chosen) == 1 and not unsure:
        library.index = chosen[0]
        return answering[chosen[0]]
    product, others = library.family.product, ", ".join(answering.values())
    if codes and answering:
        error = library.error("OpenDevice", codes[0])
        what = f"{product} {others} answers, another does not: {error.what}"
        error.say(what, f"{error.remedy} Or name one that answers as `serial`.")
        raise error
    if chosen:
        raise DeviceNotFound(library.device, f"{len(chosen)} of {product} answer: {others}.", "Name one as `serial`.")
    if codes and not answering:
        raise library.error("OpenDevice", codes[0])
    wanted = product if serial == "auto" else f"{product} with serial number {serial}"
    raise DeviceNotFound(
        library.device,
        f"no {wanted} answers{f' (there is {others})' if others else ''}.",
        "Check cable, power and `serial` in the bench file.",
    )


def _named(library: VendorLibrary, index: int, buffer: Any) -> str:
    """Its serial number. Where opening told none, as labs have met it, an initialised instrument tells it."""
    if not buffer.value:
        internal_clock = () if library.family.prefix == "PH" else (0,)
        if library.attempt("Initialize", index, 0, *internal_clock) == 0:
            library.attempt("GetSerialNumber", index, buffer)
    return str(buffer.value.decode("ascii", "replace"))


def check_alive(library: VendorLibrary, flags: int, what: str) -> None:
    """Raises `DeviceFault` where the instrument's flags say that its hardware is not to be trusted."""
    if flags & library.family.system_error:
        raise DeviceFault(library.device, f"reports a system error {what}.", "Switch the instrument off and on.")


def not_in_time(library: VendorLibrary, what: str, timeout_s: float) -> DeviceTimeout:
    """The error of points that did not come, with what to look at."""
    return DeviceTimeout(library.device, f"{what} after {timeout_s:g} s.", "Check trigger and marker wiring.")
