"""A program whose worker thread scans in short segments, and whose main thread comes to its end meanwhile.

Arguments: a bench file, and after how many seconds. Run by test_dark_all_the_same.py.
"""

import sys
import threading
import time

from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.clock import RealTimeClock
from nlos.drivers.simulated import bench as simulated_bench

simulated_bench.VirtualClock = RealTimeClock  # type: ignore[misc]
settings = load("bench", sys.argv[1], BenchSettings).settings
lit = threading.Event()


def segments() -> None:
    with open_bench(settings) as bench:
        while True:
            bench.shutter.open()
            lit.set()
            bench.clock.sleep(0.01)
            bench.shutter.close()


threading.excepthook = lambda arguments: None  # what the thread meets as the bench is closed under it
threading.Thread(target=segments, daemon=True).start()
lit.wait()
time.sleep(float(sys.argv[2]))
