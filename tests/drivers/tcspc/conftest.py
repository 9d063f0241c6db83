"""A `tcspc488` on a simulated bench whose light is counted on the fingers: point n gives n counts in bin n."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.bench import Exposure, Gate, SimulatedBench
from nlos.drivers.simulated.faults import Fault, FaultPlan
from nlos.drivers.simulated.tcspc488.firmware import Tcspc488Firmware
from nlos.drivers.simulated.usb.backend import SimulatedUsb
from nlos.drivers.tcspc.counter import HistogramAxis
from nlos.drivers.tcspc.tcspc488.counter import open_tcspc488
from nlos.drivers.tcspc.tcspc488.histogram import Tcspc488
from nlos.drivers.tcspc.tcspc488.settings import Tcspc488Settings
from nlos.drivers.tcspc.tcspc488.shutter import Tcspc488Shutter

SYNC_HZ = 10e6


def counts_of(number: int, bins: int) -> np.ndarray:
    counts = np.zeros(bins, np.uint32)
    counts[number % bins] = number
    return counts


@dataclass
class Rig:
    """Bench, cable, firmware and driver of one counter. `rate_hz` adds light to every gate, in bin 0."""

    bench: SimulatedBench
    usb: SimulatedUsb
    firmware: Tcspc488Firmware
    counter: Tcspc488
    light: dict[str, float]
    seen: list[tuple[Gate, MirrorAngles, bool]]
    wire: list[tuple[float, str, bytes]] = field(default_factory=list)

    @property
    def shutter(self) -> Tcspc488Shutter:
        return Tcspc488Shutter(self.counter)

    def counts(self, number: int) -> np.ndarray:
        axis = self.counter._axis
        return counts_of(number, axis.bins if axis else 512)


@pytest.fixture
def rig() -> Callable[..., Rig]:
    """rig(*faults, latency_s=0, bytes_per_s=inf, packet_bytes=512, bins=512, **settings): a counter, configured."""

    def make(
        *faults: Fault,
        latency_s: float = 0.0,
        bytes_per_s: float = float("inf"),
        packet_bytes: int = 512,
        bins: int = 512,
        **settings: Any,
    ) -> Rig:
        light = {"rate_hz": 0.0}
        seen: list[tuple[Gate, MirrorAngles, bool]] = []

        def shine(gate: Gate, beam: MirrorAngles, is_open: bool) -> Exposure:
            seen.append((gate, beam, is_open))
            counts = counts_of(gate.number or 0, gate.bins)
            counts[0] += round(light["rate_hz"] * gate.dwell_s) if is_open else 0
            syncs = round(SYNC_HZ * gate.dwell_s)
            return Exposure(counts, gate.dwell_s, syncs, int(counts.sum()), False)

        bench = SimulatedBench(shine, faults=FaultPlan(faults))
        firmware = Tcspc488Firmware(bench, packet_bytes=packet_bytes)
        usb = SimulatedUsb([firmware], bench.clock, latency_s, bytes_per_s)
        wire: list[tuple[float, str, bytes]] = []
        counter = open_tcspc488(
            Tcspc488Settings(model="tcspc488", usb="simulated", **settings),
            bench.clock,
            usb,
            lambda device, way, data: wire.append((bench.clock.now(), way, data)),
        )
        counter.configure(HistogramAxis(bins, 32e-12))
        return Rig(bench, usb, firmware, counter, light, seen, wire)

    return make
