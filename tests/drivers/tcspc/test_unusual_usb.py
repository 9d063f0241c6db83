"""USB at the other end that behaves as it may and seldom does: the right histograms or a named error in time, and dark.

Each oddity at any transfer of a scan: an empty packet before an answer, a stalled pipe, an answer just before its
deadline, one that comes as the transfer is cancelled, a message that is taken although the transfer is cancelled, a
part of it, a reset of the bus in between, a hub that lists its devices anew, notifications twice.
"""

import array
import os
from collections.abc import Callable
from typing import Any

import pytest

from nlos.drivers.errors import DeviceError, DeviceLost
from nlos.drivers.simulated.usb.backend import SimulatedUsb, _fail, _time_out
from nlos.drivers.simulated.usb.usbtmc_device import Transfer
from nlos.drivers.tcspc.counter import Trigger
from tests.drivers.tcspc.test_any_usb_cable import BINS, scan_in_time

SOAK = os.environ.get("NLOS_SOAK") == "1"
EVERY = 1 if SOAK else 7
PACKET = 64
READS = ("empty", "read stalls", "just in time", "one packet", "cancelled as it came")
WRITES = ("write stalls", "taken late", "taken though cancelled", "taken in part")
CONTROLS = ("control stalls", "control cancelled")
NOTIFICATIONS = ("interrupt stalls", "twice", "nothing in it", "another kind")
ANYWHERE = ("bus reset", "listed anew")
HARMLESS = ("just in time", "one packet", *CONTROLS, *NOTIFICATIONS)


class Unusual(SimulatedUsb):
    """Does `what` at the transfers `at` to `at + times - 1` where it can happen to them."""

    what, at, times, count = "", 0, 1, 0

    def strikes(self, handle: Any, kinds: tuple[str, ...]) -> str:
        now, self.count = self.count, self.count + 1
        if not (self.at <= now < self.at + self.times and self.what in (*kinds, *ANYWHERE)):
            return ""
        if self.what == "bus reset":
            handle.port.device.reset()
        elif self.what == "listed anew":
            self._pull(handle.port)
            self._plug(handle.port)
        return self.what

    def bulk_read(self, handle: Any, ep: int, intf: int, buff: "array.array[int]", timeout: int) -> int:
        what, device = self.strikes(handle, READS), handle.port.device
        if what == "read stalls":
            device.halted.add("in")
        elif what == "empty":
            device.transfers.appendleft(Transfer(b"", self._clock.now()))
        elif what == "just in time":
            for each in device.transfers:
                each.ready_s = self._clock.now() + timeout / 1000 - 0.0005
        elif what == "one packet":
            part = array.array("B", bytes(PACKET))
            came = super().bulk_read(handle, ep, intf, part, timeout)
            memoryview(buff)[:came] = memoryview(part)[:came]
            return came
        came = super().bulk_read(handle, ep, intf, buff, timeout)
        return _time_out() if what == "cancelled as it came" else came

    def bulk_write(self, handle: Any, ep: int, intf: int, data: "array.array[int]", timeout: int) -> int:
        what = self.strikes(handle, WRITES)
        if what == "write stalls":
            handle.port.device.halted.add("out")
        elif what == "taken late":
            self._clock.sleep(timeout / 1000 - 0.001)
        elif what == "taken in part":
            data = data[: min(PACKET, len(data) - 1) // 4 * 4]
        took = super().bulk_write(handle, ep, intf, data, timeout)
        if what in ("taken in part", "taken though cancelled"):
            self._clock.sleep(timeout / 1000)
        return _time_out() if what == "taken though cancelled" else took

    def intr_read(self, handle: Any, ep: int, intf: int, buff: "array.array[int]", timeout: int) -> int:
        what = self.strikes(handle, NOTIFICATIONS)
        if what == "interrupt stalls":
            handle.port.device.halted.add("interrupt")
        elif what == "nothing in it":
            return 0
        elif what == "another kind":
            memoryview(buff)[:5] = b"\x01\x02\x03\x04\x05"
            return 5
        came = super().intr_read(handle, ep, intf, buff, timeout)
        if what == "twice":
            handle.port.device.notifications.appendleft(bytes(buff[:came]))
        return came

    def ctrl_transfer(
        self, handle: Any, kind: int, request: int, value: int, index: int, data: "array.array[int]", timeout: int
    ) -> int:  # fmt: skip
        what = self.strikes(handle, CONTROLS)
        if what == "control stalls":
            _fail("stall")
        came = super().ctrl_transfer(handle, kind, request, value, index, data, timeout)
        return _time_out() if what == "control cancelled" else came


@pytest.mark.parametrize("times", [1, 3] if SOAK else [1])
@pytest.mark.parametrize("mode", ["histogram", "t3"])
@pytest.mark.parametrize("what", [*READS, *WRITES, *CONTROLS, *NOTIFICATIONS, *ANYWHERE])
def test_what_usb_may_do_spoils_no_histogram_and_keeps_no_light_on(
    rig: Callable, what: str, mode: str, times: int
) -> None:
    """`scan_in_time` compares every histogram."""
    at, met, trigger = 0, 1, Trigger.HOST
    while at <= met:
        this = rig(bins=BINS, packet_bytes=PACKET, mode=mode)
        usb = this.usb
        usb.__class__ = Unusual
        usb.what, usb.at, usb.times, usb.count = what, at, times, 0
        failed: DeviceError | None = None
        try:
            this.shutter.open()
            scan_in_time(this, trigger)
        except DeviceError as error:
            failed = error
        assert failed is None or what not in HARMLESS or times > 1
        assert what == "listed anew" or not isinstance(failed, DeviceLost)
        met, usb.what = usb.count, ""
        if what != "listed anew":  # whose watchdog closes it, see test_tcspc488_shutter.py
            this.shutter.close()
            assert not this.bench.shutter_open
        at, trigger = at + EVERY, Trigger.CLOCK if trigger is Trigger.HOST else Trigger.HOST
