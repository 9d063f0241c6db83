"""What the first and the last picture of a scan need, got ready before: neither waits for a library or a network."""

import contextlib
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.calibration.errors import CalibrationError
from nlos.chain import calibrate_scan
from nlos.live.describe import described
from nlos.loaded import LoadedScan
from nlos.recon.errors import NO_PICTURE
from nlos.recon.live import LiveReconstruction
from nlos.recon.methods import PLAIN, find

if TYPE_CHECKING:
    from nlos.live.gathered import Gathered

SIDE, BINS = 8, 128


def get_ready(lives: Sequence["LiveReconstruction"]) -> None:
    """Loads what the methods need, which takes seconds, while the first points are taken. Of a network nothing is
    rehearsed: its first picture of anything would keep the real one waiting."""
    for live in lives:
        find(live.method)
    if lives[0].method in PLAIN:
        rehearse(lives[0])


def get_ready_for_last(lives: Sequence["LiveReconstruction"], held: "Gathered", read: Callable[[], bool]) -> None:
    """While too little is left of a scan for another picture: what its last one is likely to need is built, until the
    scan is `read`."""
    with contextlib.suppress(CalibrationError, *NO_PICTURE):
        light, falloff = held.as_last()
        for live in lives:
            if read():
                return
            live.get_ready(light, falloff)


def rehearse(live: "LiveReconstruction") -> None:
    """Calibrates, reconstructs and describes a scan of 8 x 8 points of a flat wall, and forgets it."""
    plan = ScanSettings.model_validate({
        "wall": {"width_m": 1.0, "height_m": 1.0, "rows": SIDE, "cols": SIDE}, "pattern": "raster", "dwell_ms": 1,
        "histogram": {"bins": BINS, "bin_width_ps": 32, "offset_ns": 10},
    }).plan()  # fmt: skip
    counts = np.random.default_rng(0).poisson(0.2, (BINS, SIDE, SIDE)).astype(np.float32)
    counts[18:22] += np.array([20, 60, 30, 10], dtype=np.float32)[:, None, None]
    exposed = np.full((SIDE, SIDE), 1e-3)
    transient = Transient(counts, exposed, plan.wall, TimeAxis(BINS, 32e-12, 10e-9))
    scan = LoadedScan(transient, {}, exposed * 0, exposed * 0, False, None, None, None)
    with contextlib.suppress(CalibrationError):  # its libraries are loaded all the same
        calibrate_scan(scan, tell=lambda *said: None)
    rehearsed = live.anew()
    described(rehearsed.explained(rehearsed.update(transient, SIDE * SIDE), transient))
