"""The firmware of a Helios laser DAC, compiled unchanged with the core of `core/`, at the far end of the cable."""

import ctypes
import math
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.helios.outputs import Outputs
from nlos.drivers.simulated.usb.descriptors import UsbDescription

CORE = Path(__file__).parent / "core"
SOURCE = "firmware/AtmelStudio_helios/lasdac_mainfirmware/src"
CPU_HZ = 112e6


class RealFirmware:
    """A `VendorDevice` that is the vendor's `main.c`; its timers are the bench's."""

    def __init__(self, library: Path, bench: SimulatedBench, outputs: Outputs) -> None:
        self.usb = UsbDescription(0x1209, 0xE500, "Gitle Mikkelsen", "Helios Laser DAC", "", 64)
        self.outputs = outputs
        self.commands: list[int] = []
        self._c = ctypes.CDLL(str(library))
        self._c.timer_s.restype = ctypes.c_double
        self._next_s = self._centre_s = math.inf
        self._shown = (0x800, 0x800, bytes(4), False)
        self._connected = False
        self._c.power_up()
        bench.ticks(self.let_pass)

    @property
    def shutter_pin(self) -> bool:
        return bool(self._int("shutter_pin"))

    @property
    def erased(self) -> bool:
        return bool(self._int("erased"))

    def connected(self, is_connected: bool, now_s: float) -> None:
        self.let_pass(now_s)
        if is_connected or self._connected:  # an interface that was never chosen is not left
            self._call(now_s, lambda: self._c.plug(is_connected))
        self._connected = is_connected

    def bulk(self, data: bytes, now_s: float) -> bool:
        self.let_pass(now_s)
        return bool(self._call(now_s, lambda: self._c.bulk(data, len(data))))

    def command(self, data: bytes, now_s: float) -> bytes | None:
        self.let_pass(now_s)
        self.commands.append(data[0])
        said = ctypes.create_string_buffer(64)
        length = self._call(now_s, lambda: self._c.command(data, len(data), said))
        return said.raw[:length] if length > 0 else None

    def let_pass(self, now_s: float) -> None:
        while (when_s := min(self._next_s, self._centre_s)) <= now_s:
            if when_s == self._centre_s:
                self._centre_s = math.inf
                self._call(when_s, self._c.timer)
            else:
                self._call(when_s, self._c.tick)

    def _call(self, when_s: float, interrupt: Callable[[], int]) -> int:
        """An interrupt, and what it made of timers and outputs."""
        configurations, starts, ticks = self._int("configurations"), self._int("timer_starts"), self._next_s == when_s
        returned = interrupt()
        if not self._c.ticking():
            self._next_s = math.inf
        elif ticks or self._int("configurations") != configurations:
            self._next_s = when_s + self._int("cycles") / CPU_HZ
        if self._int("timer_starts") != starts:
            self._centre_s = when_s + self._c.timer_s()
        self._show(when_s)
        return returned

    def _show(self, when_s: float) -> None:
        """What changed at the outputs, as the wiring wants to be told."""
        x, y, colours = self._int("x"), self._int("y"), bytes((ctypes.c_uint8 * 4).in_dll(self._c, "colours"))
        shown, self._shown = self._shown, (x, y, colours, self._next_s < math.inf)
        if (x, y, colours) != shown[:3] or (shown[3] and self._next_s == math.inf):
            if self._next_s == math.inf and not any(colours) and (x, y) == shown[:2]:
                self.outputs.blank(when_s)
            else:
                self.outputs.put(x, y, colours, when_s)

    def _int(self, name: str) -> int:
        return ctypes.c_int.in_dll(self._c, name).value


Make = Callable[[SimulatedBench, Outputs], RealFirmware]


@pytest.fixture
def real(checkout: Callable[..., Path], compiled: Callable[..., Path], tmp_path: Path) -> Make:
    """real(bench, outputs): a DAC that has just been plugged in; each one has its own memory."""
    folder = checkout("helios_dac", SOURCE)
    for name in ("main.c", "main.h"):  # alone, so that they find the core's asf.h and not their own
        shutil.copy(folder / name, tmp_path)
    flags = ["-std=gnu99", "-fgnu89-inline", "-fPIC", "-shared", "-Dmain=firmware_main", "-I", CORE]
    library = compiled("helios.so", [tmp_path / "main.c", CORE / "core.c"], flags, compiler="gcc")
    made: list[Path] = []

    def plugged_in(bench: SimulatedBench, outputs: Outputs) -> RealFirmware:
        made.append(tmp_path / f"{len(made)}.so")
        return RealFirmware(shutil.copy(library, made[-1]), bench, outputs)

    return plugged_in
