"""A program that scans on the default bench until something ends it, and writes every byte on the cables to stderr.

Arguments: how it ends. Run by test_exit_paths.py.
"""

import os
import signal
import sys
import threading

from nlos.configs.load import load
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.tcspc.counter import HistogramAxis, PointGates


def log(device: str, direction: str, data: bytes) -> None:
    if direction == ">":
        # In one piece: a signal handler that shuts the light writes here too, and print would let it in between.
        os.write(2, f"{device} {data!r}\n".encode())


def scan(bench: Bench) -> None:
    points = 500
    bench.counter.configure(HistogramAxis(512, 32e-12, 10e-9))
    bench.shutter.open()
    for pass_ in range(10_000):
        bench.counter.arm(PointGates([1e-3] * points, list(range(points))))
        for point in range(points):
            bench.mirror.move_to(MirrorAngles(1e-4 * point, 0.0))
            bench.counter.trigger()
            bench.counter.wait_points(point + 1, 1.0)
            bench.counter.read(point, 1)
            if pass_ == 0 and point == 5:
                print("EVENT", file=sys.stderr, flush=True)
                print("scanning", flush=True)
                if ending == "exit":
                    sys.exit(7)
                if ending == "exception":
                    raise ValueError("out of ideas")
                if ending == "forgotten":
                    return
                if ending == "thread":
                    threading.Thread(target=signal.raise_signal, args=(signal.SIGTERM,)).start()


ending = sys.argv[1]
context = open_bench(load("bench", "simulated", BenchSettings).settings, wire_log=log)
if ending == "forgotten":
    scan(context.__enter__())
else:
    with context as bench:
        scan(bench)
