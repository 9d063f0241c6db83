"""What a scan will meet, looked at before anything moves: the mirror's reach, the counter's settings, the disk, the
light, and how much signal each point can expect."""

import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.planning.aim import Aim, Aiming
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording import megabytes
from nlos.acquisition.recording.condition import listed
from nlos.acquisition.recording.new_name import behind_link
from nlos.acquisition.recording.recording import EVENT, EVENT_ROWS, RECORD, Recording
from nlos.drivers.bench import Bench
from nlos.drivers.bench_settings import GeometrySettings
from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.mirror import MirrorAngles, surely_reached
from nlos.drivers.tcspc.counter import HistogramAxis

PILE_UP = 0.05
"""Detector counts per laser pulse above which early photons hide late ones (TCSPC practice)."""
LOOKS, LOOK_S = 16, 0.1
DIRECT_HALF_WIDTH_S = 0.5e-9
"""Around the highest bin, what counts as the direct reflection."""
HEADER_BYTES = 1 << 16


def aim_of(bench: Bench) -> Aim:
    """The ideal geometry that the bench file states."""
    return drawn_aim(bench.settings.geometry)


def drawn_aim(geometry: GeometrySettings) -> Aim:
    """The same, of a bench file's `geometry` block."""
    return Aim(
        geometry.wall_distance_m,
        geometry.mirror_separation_m,
        geometry.scanner_x_m,
        geometry.scanner_y_m,
        math.radians(geometry.wall_pitch_deg),
        math.radians(geometry.wall_yaw_deg),
    )


def fitted(plan: ScanPlan, bench: Bench) -> ScanPlan:
    """The plan on the time axis that the counter has nearest to its own. Raises `LimitError` where none is near."""
    axis = bench.counter.nearest_axis(plan.axis)
    return plan if axis == plan.axis else plan.on_axis(axis)


def refitted(asked: HistogramAxis, axis: HistogramAxis) -> str:
    """What to say of a plan that was `fitted`; empty where its time axis is the one asked for."""
    if axis == asked:
        return ""
    return (
        f"the counter has no {asked.bins} bins of {asked.bin_width_s * 1e12:g} ps from {asked.offset_s * 1e9:g} ns: "
        f"taking {axis.bins} of {axis.bin_width_s * 1e12:g} ps from {axis.offset_s * 1e9:g} ns, which hold that window"
    )


def checked_angles(plan: ScanPlan, bench: Bench, aim: Aiming) -> list[MirrorAngles]:
    """The mirror angles of every point. Raises `LimitError` where a point, a dwell or the time axis is out of the
    devices' reach, or of what a recorded scene holds, `InvalidData` where that has holes; nothing has been sent or
    moved then."""
    x_rad, y_rad = aim.angles_rad(plan.positions.x_m, plan.positions.y_m)
    # Of frames, each has the same points: they share their angles, and are checked once.
    _, first_at, place = np.unique(x_rad + 1j * y_rad, return_index=True, return_inverse=True)
    places = list(map(MirrorAngles, x_rad[first_at].tolist(), y_rad[first_at].tolist()))
    angles = [places[each] for each in place.reshape(-1).tolist()]
    allowed = bench.settings.geometry.allowed
    fine = surely_reached(bench.mirror, x_rad, y_rad)
    if allowed is not None:
        fine = fine and bool(allowed.holds(plan.positions.x_m, plan.positions.y_m).all())
    for number in [] if fine else np.sort(first_at).tolist():
        each = angles[number]
        if allowed is not None:
            allowed.check(plan[number].x_m, plan[number].y_m)
        try:
            bench.mirror.check(each)
        except LimitError as error:
            point = plan[number]
            what = f"wall point x = {point.x_m:+.3f} m, y = {point.y_m:+.3f} m: {error.what}"
            raise LimitError(error.device, what, error.remedy) from error
    for dwell_s in set(plan.dwell_s.tolist()):
        bench.counter.check(plan.axis, dwell_s, plan.stop)
    if bench.simulated is not None:
        if holes := bench.simulated.holes(angles):
            raise InvalidData(
                f"recorded scene: {len(holes)} of the plan's {len(plan)} points are damaged or were never measured "
                f"there: points {listed(holes)} of the plan. Photons that were never measured cannot be replayed: plan "
                "the other points only, or complete the scene (`nlos recover`, then `nlos scan --resume`)."
            )
        bench.simulated.check(angles, plan.axis, plan.dwell_s.tolist())
    return angles


def beam_within_px(plan: ScanPlan, bench: Bench, angles: Sequence[MirrorAngles]) -> float:
    """How far from its point a beam that has settled may be, in pixels of the plan's grid, at worst on the wall."""
    within_rad = 2 * math.radians(bench.settings.mirror.settle.within_deg)
    x_rad, y_rad = (np.array([getattr(each, axis) for each in angles]) for axis in ("x_rad", "y_rad"))
    geometry, wall = bench.settings.geometry, plan.wall
    x_m = (geometry.wall_distance_m / np.cos(y_rad) + geometry.mirror_separation_m) / np.cos(x_rad) ** 2 * within_rad
    y_m = geometry.wall_distance_m / np.cos(y_rad) ** 2 * within_rad
    return float(np.hypot(x_m / wall.width_m * wall.cols, y_m / wall.height_m * wall.rows).max())


def disk_bytes(plan: ScanPlan) -> int:
    """How large the recording will be."""
    points = sum(column.nbytes for column in plan.columns().values())
    samples = plan.most_samples * (plan.axis.bins * 4 + RECORD.itemsize)
    return samples + points + EVENT_ROWS * EVENT.itemsize + HEADER_BYTES


def check_disk(plan: ScanPlan, path: Path, least_free: int = 0) -> None:
    """Raises `StorageError` where the disk of `path`, whose folder may be yet to be made, has no room for the recording
    and what alarms want free beside; of a film until it is stopped, for all of the wall once."""
    least = plan.ended_after(plan.first_round) if plan.until_stopped else plan
    needed = 0 if path.exists() else disk_bytes(least)  # a recording's place on the disk is reserved as it is made
    free = shutil.disk_usage(next(folder for folder in behind_link(path).absolute().parents if folder.is_dir())).free
    if needed + least_free > free:
        beside = f" and {megabytes.needed(least_free)} free beside it (alarms.min_free_mb)" if least_free else ""
        raise StorageError(
            f"{path}: the recording needs {megabytes.needed(needed)}{beside}, the disk has "
            f"{megabytes.free(free)} left. Free disk space, choose another place with -o, or "
            f"{'set alarms.min_free_mb lower' if needed == 0 else 'plan fewer points or bins'}."
        )


@dataclass(frozen=True)
class ExpectedRates:
    """Detector rates in 1/s with the beam on the wall, the mean over it."""

    direct_hz: float
    indirect_hz: float
    background_hz: float
    """Dark counts and stray light within the histogram."""

    @property
    def total_hz(self) -> float:
        return self.direct_hz + self.indirect_hz + self.background_hz

    @classmethod
    def of_recording(cls, recording: Recording) -> "ExpectedRates":
        """As a recording of the same bench and scene showed them. Raises `InvalidData` for one without samples."""
        counts = np.zeros(recording.plan.axis.bins)
        for _, block, intact in recording.blocks():
            counts += block[intact].sum(axis=0)
        recording.left_aside()
        live_s = float(recording.intact_records()["live_time_s"].sum())
        if not live_s > 0:
            raise InvalidData(f"{recording.path}: holds no samples to learn rates from")
        return cls.of_histogram(counts, live_s, recording.plan.axis)

    @classmethod
    def of_simulation(cls, plan: ScanPlan, bench: Bench, angles: Sequence[MirrorAngles]) -> "ExpectedRates":
        """As a simulated bench shows them, at some points of the plan: its own photons, before any scan."""
        axis, counts = plan.axis, np.zeros(plan.axis.bins)
        chosen = np.unique(np.linspace(0, len(plan) - 1, LOOKS).astype(int))
        if bench.simulated is None:
            raise ValueError(f"bench {bench.settings.name} is real: its count rates are not known before a scan")
        for number in chosen.tolist():
            counts += bench.simulated.look(angles[number], axis, LOOK_S, number)
        return cls.of_histogram(counts, len(chosen) * LOOK_S, axis)

    @classmethod
    def of_histogram(cls, counts: npt.NDArray[np.float64], live_s: float, axis: HistogramAxis) -> "ExpectedRates":
        """The quietest sixteenth of the time axis is background, the highest peak direct light, the rest indirect."""
        rate_hz = counts / live_s
        quiet = np.convolve(rate_hz, np.ones(axis.bins // 16) / (axis.bins // 16), mode="valid").min()
        reach, peak = round(DIRECT_HALF_WIDTH_S / axis.bin_width_s), int(np.argmax(rate_hz))
        window = slice(max(peak - reach, 0), peak + reach + 1)
        direct_hz = float((rate_hz[window] - quiet).sum())
        rest_hz = float((rate_hz - quiet).sum()) - direct_hz
        return cls(max(direct_hz, 0.0), max(rest_hz, 0.0), float(quiet) * axis.bins)


@dataclass(frozen=True)
class Expectation:
    """What a typical point of a plan will hold, in counts, and its signal-to-noise ratio."""

    direct: float
    indirect: float
    background: float

    @property
    def signal_to_noise(self) -> float:
        """Indirect light over its own shot noise and the background's, in one point's whole histogram."""
        noise = (self.indirect + self.background) ** 0.5
        return self.indirect / noise if noise else 0.0


def expectation(plan: ScanPlan, rates: ExpectedRates) -> Expectation:
    """Counts at the median dwell of the first pass."""
    dwell_s = float(np.median(plan.dwell_s[plan.pass_ == 0]))
    return Expectation(rates.direct_hz * dwell_s, rates.indirect_hz * dwell_s, rates.background_hz * dwell_s)


def check_light(rates: ExpectedRates, repetition_hz: float) -> None:
    """Raises `LimitError` where so many photons come that pile-up distorts histograms."""
    limit_hz = PILE_UP * repetition_hz
    if rates.total_hz > limit_hz:
        raise LimitError(
            "detector",
            f"{rates.total_hz:.3g} counts/s are expected, above {PILE_UP:.0%} of {repetition_hz:.3g} laser pulses/s: "
            "pile-up.",
            "Attenuate the laser or the detector's light.",
        )
