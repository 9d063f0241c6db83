"""QMI's drivers of PicoQuant's instruments in front of the stand-in for their libraries. Prints what they measured.

run_qmi.py SITE_PACKAGES DEVICE MODE
"""

import ctypes
import json
import sys
from typing import Any

import numpy as np

from nlos.drivers.simulated.bench import Exposure, Gate, SimulatedBench
from nlos.drivers.simulated.picoquant.library import PicoquantLibrary
from nlos.drivers.tcspc.picoquant.families import FAMILIES
from nlos.drivers.tcspc.t3 import T3Decoder
from tests.peers.picoquant.c_calls import CCalls

folder, DEVICE, MODE = sys.argv[1:]
sys.path.append(folder)  # behind our own packages
family, random = FAMILIES[DEVICE], np.random.default_rng(7)


def light(gate: Gate, *_: Any) -> Exposure:
    """A peak at 12 ns, 40,000 photons a second."""
    times_s = gate.offset_s + gate.bin_width_s * (np.arange(gate.bins) + 0.5)
    shape = np.exp(-0.5 * ((times_s - 12e-9) / 0.3e-9) ** 2)
    counts = random.poisson(4e4 * gate.dwell_s * shape / max(shape.sum(), 1e-9)).astype(np.uint32)
    return Exposure(counts, gate.dwell_s, round(10e6 * gate.dwell_s), int(counts.sum()), False)


bench = SimulatedBench(light)
library = CCalls(PicoquantLibrary(bench, DEVICE, 10e6), bench)
ctypes.cdll.LoadLibrary = lambda *_: library  # type: ignore[method-assign]

from qmi.core.context import QMI_Context  # noqa: E402
from qmi.instruments.picoquant.hydraharp import PicoQuant_HydraHarp400  # noqa: E402
from qmi.instruments.picoquant.multiharp import PicoQuant_MultiHarp150  # noqa: E402
from qmi.instruments.picoquant.picoharp import PicoQuant_PicoHarp300  # noqa: E402
from qmi.instruments.picoquant.support._decoders import EventFilterMode  # noqa: E402

DRIVERS = {
    "multiharp150": PicoQuant_MultiHarp150,
    "hydraharp400": PicoQuant_HydraHarp400,
    "picoharp300": PicoQuant_PicoHarp300,
}
host: Any = DRIVERS[DEVICE](QMI_Context("peers"), "counter", "1050001")


def set_up() -> None:
    host.open()
    host.initialize(MODE, *(() if family.prefix == "PH" else ("INTERNAL",)))
    if family.constant_fraction:
        host.calibrate()
    host.set_sync_divider(1)
    if family.prefix == "MH":
        host.set_sync_edge_trigger(-50, "FALLING")
        host.set_input_edge_trigger(0, -50, "FALLING")
    elif family.prefix == "HH":
        host.set_sync_cfd(100, 10)
        host.set_input_cfd(0, 100, 10)
    else:
        host.set_input_cfd(0, 100, 10)
        host.set_input_cfd(1, 100, 10)
    host.set_binning(3)
    host.set_offset(0)
    bench.clock.sleep(family.rates_valid_s)


def finished() -> None:
    while host.get_measurement_active():
        bench.clock.sleep(0.01)


def histogram() -> dict[str, Any]:
    if family.fixed_bins is None:
        host.set_histogram_length(6)
    host.set_stop_overflow(False, 65_535)
    if family.prefix == "PH":
        library.PH_ClearHistMem(0, 0)
    else:
        host.clear_histogram_memory()
    host.start_measurement(500)
    finished()
    host.stop_measurement()
    said = host.get_histogram(0, *((0,) if family.prefix == "HH" else ()))
    return {
        "counts": said.tolist(), "resolution_ps": host.get_resolution(), "flags": host.get_flags(),
        "elapsed_ms": host.get_elapsed_measurement_time(),
        "ours": library._functions._counts.tolist(),
    }  # fmt: skip


def events() -> dict[str, Any]:
    steps = [0]

    def step(when_s: float) -> None:
        steps[0] += 1
        bench.edge(f"marker_{2 - steps[0] % 2}", when_s)

    bench.wire("pixel_clock", step)
    host.set_marker_edges(*["RISING"] * 4)
    host.set_marker_enable(True, True, True, False)
    host.set_event_filter(channel_filter=dict.fromkeys(range(65, 80), EventFilterMode.ALL_EVENTS))  # marks
    host.start_measurement(500)
    if family.trigger_output:
        host.set_trigger_output(200_000)
    finished()
    records = 0
    while True:  # its thread reads meanwhile
        with host._fetch_events_thread._condition:
            if len(library.records) == records and records:
                break
            records = len(library.records)
            host._fetch_events_thread._condition.wait(0.05)
    said = host.get_events()
    host.stop_measurement()
    ours = T3Decoder(family.layout).feed(np.asarray(library.records, np.uint32))
    period_ps, width_ps = 1e12 / host.get_sync_rate(), host.get_resolution()
    photons, marks = said[said["type"] == 0], said[said["type"] > 64]
    return {
        "photons": photons["timestamp"].tolist(), "marks": marks["timestamp"].tolist(),
        "bits": (marks["type"] - 64).tolist(),
        "our_photons": (ours.photon_pulses * period_ps + family.layout.delays(ours.photons) * width_ps).tolist(),
        "our_marks": (ours.marker_pulses * period_ps).tolist(), "our_bits": ours.marker_bits.tolist(),
    }  # fmt: skip


if __name__ == "__main__":
    set_up()
    rates = [host.get_count_rate(0)] if family.prefix == "PH" else [host.get_sync_rate(), host.get_count_rate(0)]
    measured = histogram() if MODE == "HIST" else events()
    host.close()
    print(json.dumps({"rates": rates, "refused": library.refused, **measured}))
