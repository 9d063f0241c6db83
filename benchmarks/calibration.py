"""Calibration: how fast, how accurate on a measured scan, and how well known constants are recovered.

Prints one JSON line a figure. The table of recovered constants comes from simulated benches with a tilted wall and
three detector models, at rates up to a fifth of the laser's; every constant is given with its own standard error.
"""

import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from time import perf_counter

if sys.path and Path(sys.path[0] or ".").resolve() == Path(__file__).resolve().parent:
    sys.path.pop(0)  # or this file would be taken for the package of its name

import numpy as np

from nlos.acquisition.importers.plain import read_plain
from nlos.acquisition.planning.aim import Aim
from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.calibration import raw_points
from nlos.calibration.constants import BenchConstants, Quantity
from nlos.calibration.correct import common_bins, correct_known, correct_points
from nlos.calibration.detector import undo_dead_time
from nlos.calibration.measure import KnownBefore, measure_constants
from nlos.calibration.raw_points import RawPoints
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.beam import BeamPath, Misalignment
from nlos.drivers.simulated.bench import Gate
from nlos.drivers.simulated.scene import SceneLight, SceneSettings
from nlos.drivers.simulated.spad import DetectorSettings, draw, generator
from nlos.drivers.simulated.surfaces import Surface

REAL = Path(__file__).parents[2] / "shared" / "data" / "real"
REPETITION_HZ = 10e6
SHARES = (0.05, 0.2)
"""Direct photons per laser pulse."""
DATE = "2026-01-01T00:00:00+00:00"
DETECTORS = {
    "thin SPAD": DetectorSettings(jitter_fwhm_ps=70, dark_cps=100, dead_time_ns=77),
    "fast SPAD": DetectorSettings(jitter_fwhm_ps=40, tail_fraction=0.02, dark_cps=400, dead_time_ns=20),
    "ringing SPAD": DetectorSettings(
        jitter_fwhm_ps=95, tail_fraction=0.1, tail_ps=250, dark_cps=2000, dead_time_ns=45,
        afterpulse_probability=0.03, afterpulse_ns=30,
    ),
}  # fmt: skip
"""Detector model -> what it does. Afterpulses are followed only where the histogram covers the laser's period."""


def figure(name: str, value: float, unit: str, target: float | None = None, at_least: bool = False) -> None:
    """One line of the result."""
    met = None if target is None else bool(value >= target if at_least else value <= target)
    print(
        json.dumps({"figure": name, "value": round(value, 4), "unit": unit, "target": target, "met": met}), flush=True
    )


def simulated_run(
    detector: DetectorSettings,
    scene: SceneSettings,
    off: Misalignment,
    aim: Aim,
    side: int,
    axis: TimeAxis,
    dwell_s: float,
    shutter_open: bool = True,
    seed: int = 5,
) -> RawPoints:
    """What a bench records that aims by `aim` while its wall and mirrors are `off`."""
    path = BeamPath(aim.wall_distance_m, aim.mirror_separation_m, off)
    light = SceneLight(scene, detector, path, REPETITION_HZ, seed)
    wall = WallGrid(1.2, 1.2, side, side)
    x, y = (a.ravel() for a in np.meshgrid(wall.x_m(), wall.y_m()))
    x_rad, y_rad = aim.angles_rad(x, y)
    gate = Gate(0.0, dwell_s, axis.bins, axis.bin_width_s, axis.start_s)
    taken = []
    for number, (a, b) in enumerate(zip(x_rad, y_rad, strict=True)):
        beam = MirrorAngles(float(a), float(b))
        photons = light.photons_per_pulse(path.spot(beam) if shutter_open else None, axis.bin_width_s, axis.start_s)
        clicks = clicks_per_pulse(photons, axis.bin_width_s, detector)
        numbered = replace(gate, number=number)
        taken.append(draw(clicks, numbered, REPETITION_HZ, generator(seed, numbered, beam)))
    return RawPoints(
        np.stack([t.counts for t in taken]),
        x,
        y,
        np.array([t.live_s for t in taken]),
        np.array([float(t.sync_count) for t in taken]),
        np.array([float(t.total_count) for t in taken]),
        axis,
    )


def clicks_per_pulse(photons: np.ndarray, bin_width_s: float, detector: DetectorSettings) -> np.ndarray:
    """Expected clicks per pulse (P,) of a free-running detector whose afterpulses follow its clicks, one dead time
    later: the steady state, by iteration, from `photons` per pulse (P,)."""
    bins, dead = len(photons), round(detector.dead_time_ns * 1e-9 / bin_width_s)
    kernel = np.roll(np.exp(-np.arange(bins) * bin_width_s / (detector.afterpulse_ns * 1e-9)), dead)
    spectrum = np.fft.rfft(kernel * detector.afterpulse_probability / kernel.sum())
    index = (np.arange(bins) - dead) % bins
    clicks = photons
    for _ in range(60):
        running = np.concatenate([[0.0], np.cumsum(clicks)])
        blind = running[:-1] - running[index] + np.where(np.arange(bins) < dead, running[-1], 0.0)
        after = np.fft.irfft(np.fft.rfft(clicks) * spectrum, bins)
        clicks = -np.expm1(-(photons + after)) * (1 - blind)
    return np.clip(clicks, 0, None)


def recovered(name: str, detector: DetectorSettings, share: float, seed: int = 5) -> list[dict[str, object]]:
    """Rows of the table for one detector at direct light of `share` photons per laser pulse."""
    off = Misalignment(wall_pitch_deg=3.0, wall_yaw_deg=-4.0)
    aim = Aim(2.0)
    scene = SceneSettings(
        objects=(Surface(letter="S", centre_m=(0.0, 0.0, 0.8), height_m=0.5),),
        direct_cps=share * REPETITION_HZ,
        hidden_cps=500e3,
        ambient_cps=3000.0,
        delay_ns=0.35,
        surfel_m=0.05,
    )
    width = 50e-12
    whole = TimeAxis(round(1 / REPETITION_HZ / width), width, 8e-9)
    raw = simulated_run(detector, scene, off, aim, 24, whole, 0.05, seed=seed)
    dark_scene = replace_ambient(scene)
    dark = simulated_run(detector, dark_scene, off, aim, 8, whole, 2.0, shutter_open=False, seed=seed + 1)
    found = measure_constants([raw, dark], devices={}, sources=[name], measured_utc=DATE, aim=aim)
    measured_dead_time = found.constants.dead_time_s
    if measured_dead_time is None:  # too little light to tell: the data sheet does
        sheet = Quantity(detector.dead_time_ns * 1e-9, 0.0)
        found = measure_constants(
            [raw, dark], devices={}, sources=[name], measured_utc=DATE, aim=aim, known=KnownBefore(dead_time=sheet)
        )
    constants, fit = found.constants, found.geometry
    assert fit is not None
    assert constants.dark_hz is not None
    assert constants.ambient_hz is not None
    degree = np.pi / 180
    rows = [
        ("wall_distance_m", 2.0, fit.geometry.wall_distance_m, fit.errors["wall_distance_m"]),
        ("wall_pitch_deg", 3.0, fit.geometry.wall_pitch_rad / degree, fit.errors["wall_pitch_rad"] / degree),
        ("wall_yaw_deg", -4.0, fit.geometry.wall_yaw_rad / degree, fit.errors["wall_yaw_rad"] / degree),
        ("delay_ns", 0.35, fit.delay_s * 1e9, fit.errors["delay_s"] * 1e9),
        ("dark_hz", detector.dark_cps, constants.dark_hz.value, constants.dark_hz.error),
        ("ambient_hz", 3000.0, constants.ambient_hz.value, constants.ambient_hz.error),
    ]
    if measured_dead_time is not None:
        rows.append(
            ("dead_time_ns", detector.dead_time_ns, measured_dead_time.value * 1e9, measured_dead_time.error * 1e9)
        )
    if detector.afterpulse_probability and constants.afterpulse_probability is not None:
        after = constants.afterpulse_probability
        rows.append(("afterpulse_probability", detector.afterpulse_probability, after.value, after.error))
    truth = true_photons(detector, scene, off, aim, raw)
    photons = float(undo_dead_time(raw, constants)[0].sum())
    table: list[dict[str, object]] = [
        {
            "detector": name, "share": share, "constant": key, "true": true, "found": value, "error": error,
            "sigmas": abs(value - true) / error, "met": abs(value - true) <= 3 * error,
        }
        for key, true, value, error in rows
    ]  # fmt: skip
    off_by = photons / truth - 1
    table.append(
        {
            "detector": name,
            "share": share,
            "constant": "photons",
            "true": truth,
            "found": photons,
            "off_by": off_by,
            "met": abs(off_by) <= 0.01,
        }
    )
    return table


def replace_ambient(scene: SceneSettings) -> SceneSettings:
    """The same scene in a dark room: a dark run is taken with the detector covered."""
    return scene.model_copy(update={"ambient_cps": 0.0})


def true_photons(
    detector: DetectorSettings, scene: SceneSettings, off: Misalignment, aim: Aim, raw: RawPoints
) -> float:
    """Photons that a detector without dead time would have counted in the whole run."""
    path = BeamPath(aim.wall_distance_m, aim.mirror_separation_m, off)
    light = SceneLight(scene, detector, path, REPETITION_HZ, 0)
    total = 0.0
    x_rad, y_rad = aim.angles_rad(raw.x_m, raw.y_m)
    for a, b, pulses in zip(x_rad, y_rad, raw.sync_count, strict=True):
        spot = path.spot(MirrorAngles(float(a), float(b)))
        total += float(light.photons_per_pulse(spot, raw.time.bin_width_s, raw.time.start_s).sum() * pulses)
    return total


def offset_rms_bins() -> tuple[float, float]:
    """RMS and largest error of the measured scan's time offsets, up to one common constant."""
    plain = read_plain(REAL / "rawscan_semisynth_s_u.h5")
    assert plain.time_offset_bins is not None
    done = correct_points(raw_points.from_transient(plain.transient))
    assert done.offsets is not None
    off = done.offsets.offset_bins - plain.time_offset_bins.ravel()
    off -= off.mean()
    return float(np.sqrt((off**2).mean())), float(np.abs(off).max())


def stream(part: tuple[RawPoints, BenchConstants, int, int, int]) -> int:
    """Corrects a scan by known constants, `block` histograms at a time, `repeats` times; returns how many it did."""
    raw, constants, bins, block, repeats = part
    blocks = [raw.select(slice(first, first + block)) for first in range(0, len(raw.counts), block)]
    for _ in range(repeats):
        for one in blocks:
            correct_known(one, constants, bins)
    return repeats * len(raw.counts)


def throughput() -> tuple[float, float]:
    """Histograms of 512 bins a minute that two cores correct by known constants, dead time and pile-up included: in
    the blocks of 64 that recordings are written in, and one by one."""
    axis = TimeAxis(512, 32e-12, 10e-9)
    detector = DETECTORS["thin SPAD"]
    scene = SceneSettings(direct_cps=200e3, ambient_cps=1000.0)
    raw = simulated_run(detector, scene, Misalignment(), Aim(2.0), 32, axis, 8e-3)
    sheet = Quantity(77e-9, 0.0)
    found = measure_constants(
        [raw], devices={}, sources=[], measured_utc=DATE, aim=Aim(2.0), known=KnownBefore(dead_time=sheet)
    )
    bins = common_bins(found.constants, raw.x_m, raw.y_m, axis)
    best = {64: 0.0, 1: 0.0}
    with ProcessPoolExecutor(2) as pool:
        for block, repeats in ((64, 20), (1, 3)) * 4:
            parts = [(raw, found.constants, bins, block, repeats)] * 2
            started = perf_counter()
            done = sum(pool.map(stream, parts))
            best[block] = max(best[block], 60 * done / (perf_counter() - started))
    return best[64], best[1]


def main() -> None:
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    rows = [row for name, d in DETECTORS.items() for share in SHARES for row in recovered(name, d, share)]
    for row in rows:
        print(json.dumps(row, default=float), flush=True)
    figure("constants_recovered", sum(bool(r["met"]) for r in rows) / len(rows), "share", 1.0, at_least=True)
    per_min, one_by_one = throughput()
    figure("histograms_per_min", per_min, "1/min", 1e6, at_least=True)
    figure("histograms_per_min_one_by_one", one_by_one, "1/min")
    if REAL.exists():
        rms, worst = offset_rms_bins()
        figure("offset_rms_bins", rms, "bins", 0.5)
        figure("offset_worst_bins", worst, "bins", 3.0)
    else:
        print(f"offset_rms_bins: {REAL} is not here", file=sys.stderr)


if __name__ == "__main__":
    main()
