"""A recorded scan as the scene: its photons handed out again, thinned to the dwell asked for."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import scipy

from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated import spad
from nlos.drivers.simulated.beam import BeamPath, Spot
from nlos.drivers.simulated.bench import Exposure, Gate
from nlos.drivers.tcspc.counter import WAITING_NUMBERS

_SALT = 1


@dataclass(frozen=True)
class RecordedScan:
    """Raw counts of N visits to wall points, in wall coordinates; what `open_bench` takes as a scene.

    `total_count` (N,), where known, are all detections, those outside the time window included. Of several visits to
    one place a gate gets that of its own point `number`, else the one nearest to it in time.
    """

    counts: npt.NDArray[np.uint32]  # (N, T)
    x_m: npt.NDArray[np.float64]  # (N,)
    y_m: npt.NDArray[np.float64]  # (N,)
    exposure_s: npt.NDArray[np.float64]  # (N,)
    bin_width_s: float
    offset_s: float = 0.0
    total_count: npt.NDArray[np.int64] | None = None
    holes_m: npt.NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    """Places (M, 2) where it was to be measured, but was not, or is damaged."""
    number: npt.NDArray[np.int64] | None = None
    """(N,) of the recorded plan."""
    taken_s: npt.NDArray[np.float64] | None = None
    """(N,) when each visit began, in seconds since the first one."""

    def __post_init__(self) -> None:
        points = (len(self.counts),)
        if self.counts.ndim != 2 or any(a.shape != points for a in (self.x_m, self.y_m, self.exposure_s)):
            raise ValueError(
                f"a recorded scan needs counts (N, T) with x_m, y_m, exposure_s (N,); found {self.counts.shape}, "
                f"{self.x_m.shape}, {self.y_m.shape}, {self.exposure_s.shape}"
            )
        if not (self.exposure_s > 0).any():
            raise ValueError("the recorded scan holds no measured point")


class RecordedLight:
    """A `Light` that hands out a recorded scan's photons: each is kept with probability dwell / recorded exposure.

    Thinned Poisson counts are again Poisson counts, so a shorter dwell is rehearsed exactly; a longer one is refused.
    With the shutter closed there is nothing to hand out: a recording does not say which of its photons were dark.
    """

    def __init__(
        self, scan: RecordedScan, path: BeamPath, repetition_hz: float, seed: int, tolerance_m: float | None = None
    ) -> None:
        self._scan, self._path, self._repetition_hz, self._seed = scan, path, repetition_hz, seed
        self._measured = np.flatnonzero(scan.exposure_s > 0)
        places_m = np.stack([scan.x_m[self._measured], scan.y_m[self._measured]], axis=1)
        apart_m, place = np.unique(places_m, axis=0, return_inverse=True)
        self._apart_m = apart_m
        place = place.reshape(-1)
        by_place = self._measured[np.argsort(place, kind="stable")]
        self._visits = np.split(by_place, np.cumsum(np.bincount(place))[:-1])
        self._tolerance_m = _tolerance_m(*apart_m.T) if tolerance_m is None else tolerance_m
        self._places, self._holes = scipy.spatial.KDTree(apart_m), scipy.spatial.KDTree(scan.holes_m)

    def __call__(self, gate: Gate, beam: MirrorAngles, shutter_open: bool) -> Exposure:
        pulses = round(gate.dwell_s * self._repetition_hz)
        if not shutter_open:
            return Exposure(np.zeros(gate.bins, dtype=np.uint32), gate.dwell_s, pulses, 0, False)
        rng = spad.generator(self._seed, gate, beam, _SALT)
        if not gate.kept or gate.number in WAITING_NUMBERS:
            shown = int(rng.poisson(self._rate_cps(beam) * gate.dwell_s))
            return Exposure(np.zeros(gate.bins, dtype=np.uint32), gate.dwell_s, pulses, shown, False)
        point = self._visit(gate, beam)
        part = self._part(point, gate.dwell_s)
        recorded = self._scan.counts[point]
        kept = rng.binomial(recorded, part)
        outside = self._detections(point) - int(recorded.sum(dtype=np.int64))
        total = int(kept.sum()) + int(rng.binomial(outside, part))
        counts = rebin(kept, self._scan.bin_width_s, self._scan.offset_s, gate).astype(np.uint32)
        return spad.stop_at_counts(Exposure(counts, gate.dwell_s, pulses, total, False), gate, rng)

    def check(self, gate: Gate, beam: MirrorAngles) -> None:
        """Raises `LimitError` where nothing was recorded, not as long, or not in such bins."""
        self._part(self._visit(gate, beam), gate.dwell_s)
        rebin(np.zeros(0, dtype=np.int64), self._scan.bin_width_s, self._scan.offset_s, gate)

    def is_hole(self, beam: MirrorAngles) -> bool:
        """Whether the recording lacks just this place: it was to be measured there, but is not, or is damaged."""
        spot = self._path.spot(beam)
        return spot is not None and bool(self._near(self._holes, spot)) and not self._near(self._places, spot)

    def _part(self, point: int, dwell_s: float) -> float:
        """Which part of a point's photons a dwell gets."""
        recorded_s = float(self._scan.exposure_s[point])
        # Exposures are stored in whole microseconds by some instruments.
        if dwell_s > recorded_s + 1e-6:
            raise LimitError(
                "recorded scene",
                f"a dwell of {dwell_s * 1e3:g} ms is longer than the {recorded_s * 1e3:g} ms recorded there.",
                "Shorten dwell_ms in the plan; photons that were never measured cannot be replayed.",
            )
        return min(1.0, dwell_s / recorded_s)

    def _near(self, places: "scipy.spatial.KDTree", spot: Spot) -> list[int]:
        """Those of many places that the beam may be meant for."""
        return sorted(places.query_ball_point((spot.x_m, spot.y_m), self._tolerance_m))

    def _detections(self, point: int) -> int:
        """All that were recorded at a point, those outside the time window included where they are known."""
        inside = int(self._scan.counts[point].sum(dtype=np.int64))
        return inside if self._scan.total_count is None else max(inside, int(self._scan.total_count[point]))

    def _rate_cps(self, beam: MirrorAngles) -> float:
        """What a rate meter shows there; 0 where nothing was recorded."""
        try:
            point = int(self._nearest(beam)[0])
        except LimitError:
            return 0.0
        return self._detections(point) / float(self._scan.exposure_s[point])

    def _visit(self, gate: Gate, beam: MirrorAngles) -> int:
        """The recorded visit whose photons a gate gets."""
        visits = self._nearest(beam)
        if self._scan.number is not None and gate.number is not None:
            own = visits[self._scan.number[visits] == gate.number]
            if len(own):
                return int(own[-1])
        if self._scan.taken_s is None:
            return int(visits[0])
        return int(visits[np.abs(self._scan.taken_s[visits] - gate.since_lit_s).argmin()])

    def _nearest(self, beam: MirrorAngles) -> npt.NDArray[np.int64]:
        """All visits to the nearest place."""
        spot = self._path.spot(beam)
        if spot is not None and (near := self._near(self._places, spot)):
            away_m = np.hypot(*(self._apart_m[near] - (spot.x_m, spot.y_m)).T)
            return self._visits[near[int(away_m.argmin())]]
        where = "off the wall" if spot is None else f"at x = {spot.x_m:+.4f} m, y = {spot.y_m:+.4f} m"
        raise LimitError(
            "recorded scene",
            f"nothing was recorded {where} (within {self._tolerance_m * 1e3:.1f} mm).",
            "Plan a wall and grid that lie within the recorded one.",
        )


def rebin(counts: npt.NDArray[np.int64], bin_width_s: float, offset_s: float, gate: Gate) -> npt.NDArray[np.int64]:
    """Recorded counts (T,) on the gate's own bins (gate.bins,), zero where nothing was recorded.

    Raises `LimitError` where the gate's bins are not whole numbers of recorded ones: photons are not split.
    """
    ratio = gate.bin_width_s / bin_width_s
    shift = (offset_s - gate.offset_s) / bin_width_s
    group, lead = round(ratio), round(shift)
    if group < 1 or abs(ratio - group) > 1e-6 or abs(shift - lead) > 1e-3:
        raise LimitError(
            "recorded scene",
            f"was recorded in bins of {bin_width_s * 1e12:g} ps from {offset_s * 1e9:g} ns; bins of "
            f"{gate.bin_width_s * 1e12:g} ps from {gate.offset_s * 1e9:g} ns do not lie on them.",
            "Set histogram.bin_width_ps to a multiple of the recorded one, and offset_ns to match.",
        )
    fine = np.zeros(gate.bins * group, dtype=np.int64)
    source = counts[max(0, -lead) : max(0, len(fine) - lead)]
    start = max(0, lead)
    fine[start : start + len(source)] = source
    grouped: npt.NDArray[np.int64] = fine.reshape(gate.bins, group).sum(axis=1)
    return grouped


def _tolerance_m(x_m: npt.NDArray[np.float64], y_m: npt.NDArray[np.float64]) -> float:
    """How far from a recorded point the beam may land: a grid cell's half diagonal, from the area per point."""
    if len(x_m) < 2:
        return 0.01
    area_m2 = max(float(np.ptp(x_m)) * float(np.ptp(y_m)), 1e-4)
    return float(np.sqrt(area_m2 / len(x_m) / 2))
