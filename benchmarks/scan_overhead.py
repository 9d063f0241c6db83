"""Software time per scanned point: 64 x 64 points in scheme S1 on cables that take no time, simulator included.

The bench's clock is virtual, so the wall time that passes is the software's: driver, pyserial, pyusb, both firmwares,
the detector's photons, engine and recording. The floor is what the simulated light alone costs in the same run.
"""

import json
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.planning.schemes import Scheme
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.engine import record, scan
from nlos.configs.load import load
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.drivers.simulated.bench import Gate

RUNS = 3


def figure(name: str, value: float, unit: str, target: float | None = None) -> None:
    met = None if target is None else bool(value <= target)
    print(json.dumps({"figure": name, "value": round(value, 4), "unit": unit, "target": target, "met": met}))


def one_scan(bench: Bench, folder: Path) -> np.ndarray:
    """Seconds from each sample to the next, all recorded."""
    plan = load("scan", "demo", ScanSettings).settings.plan()
    moments = [time.perf_counter()]
    with RecordingWriter.create(folder / "run.h5", plan, Header(), overwrite=True) as writer:
        record(scan(plan, bench, scheme=Scheme.STEPPED), writer, lambda sample: moments.append(time.perf_counter()))
    return np.diff(moments)


def light_alone_s(bench: Bench) -> float:
    """What one exposure of the simulated scene costs: the part of the overhead that no real bench has."""
    assert bench.simulated is not None
    bench.simulated.set_shutter(True)
    started = time.perf_counter()
    for number in range(500):
        bench.simulated.expose(Gate(bench.clock.now(), 0.008, 1024, 16e-12, 10e-9, number))
    bench.simulated.set_shutter(False)
    return (time.perf_counter() - started) / 500


def main() -> None:
    with (
        tempfile.TemporaryDirectory() as folder,
        open_bench(load("bench", "zero_latency", BenchSettings).settings) as bench,
    ):
        runs = [one_scan(bench, Path(folder)) for _ in range(RUNS)]
        floor_s = light_alone_s(bench)
    best = min(runs, key=lambda steps: float(steps.mean()))
    figure("overhead_ms", float(best.mean()) * 1e3, "ms", 0.8)
    figure("overhead_p99_ms", float(np.quantile(best, 0.99)) * 1e3, "ms", 3.0)
    figure("light_alone_ms", floor_s * 1e3, "ms")
    figure("overhead_over_light_alone", float(best.mean()) / floor_s, "ratio")
    rss_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 if sys.platform == "linux" else 1024**2)
    figure("peak_rss_mb", rss_mb, "MB", 300.0)
    assert "torch" not in sys.modules


if __name__ == "__main__":
    main()
