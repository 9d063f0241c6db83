"""How long 128 x 128 points of 8 ms take on a bench with real timing figures, in its own time, scheme by scheme.

The arithmetic: 131.07 s is dwell. A mirror that settles in 0.4 ms adds 6.55 s. In scheme S1 each point also pays for
two serial commands (1 ms each there and back), a trigger and a question over USB; in S2 and S3 only the 14 uploads
of up to 1200 positions remain.
"""

import json
import sys
import time

from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.planning.schemes import Scheme
from nlos.acquisition.scanning.control import ScanControl, ScanState
from nlos.acquisition.scanning.engine import scan
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench

POINTS = 128 * 128
PLAN = {
    "wall": {"width_m": 2.0, "height_m": 2.0, "rows": 128, "cols": 128},
    "pattern": "serpentine",
    "dwell_ms": 8,
}
BENCHES = {Scheme.STEPPED: "simulated", Scheme.CLOCKED: "simulated", Scheme.LISTED: "multiharp"}
BIN_WIDTHS_PS = {Scheme.STEPPED: 32, Scheme.CLOCKED: 32, Scheme.LISTED: 40}
"""What each counter can be set to exactly."""
TARGETS_S = {Scheme.STEPPED: 195.0, Scheme.CLOCKED: 139.0, Scheme.LISTED: 139.0}


def figure(name: str, value: float, unit: str, target: float | None = None) -> None:
    met = None if target is None else bool(value <= target)
    print(json.dumps({"figure": name, "value": round(value, 4), "unit": unit, "target": target, "met": met}))


def main() -> None:
    for scheme, name in BENCHES.items():
        word = scheme.value.lower()
        axis = {"bins": 512, "bin_width_ps": BIN_WIDTHS_PS[scheme], "offset_ns": 10}
        plan = ScanSettings.model_validate({**PLAN, "histogram": axis}).plan()
        started = time.perf_counter()
        with open_bench(load("bench", name, BenchSettings).settings) as bench:
            events: list[tuple[str, str]] = []
            bench.on_event = lambda kind, text, log=events: log.append((kind, text))
            control, begun_s = ScanControl(), bench.clock.now()
            taken = sum(1 for _ in scan(plan, bench, scheme=scheme, control=control))
            bench_s = bench.clock.now() - begun_s
        assert taken == POINTS
        assert control.state is ScanState.COMPLETE
        figure(f"{word}_s", bench_s, "s", TARGETS_S[scheme])
        figure(f"{word}_duty", plan.dwell_total_s / bench_s, "ratio")
        expected = next(text for kind, text in events if kind == "scheme")
        print(f"{word}: {expected}; {time.perf_counter() - started:.1f} s of wall time", file=sys.stderr)


if __name__ == "__main__":
    main()
