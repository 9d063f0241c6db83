"""Short measurements at one place: gates started by the host, and when light arrives in them."""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.acquisition.scanning.left_to_take import SPOILT
from nlos.drivers.bench import Bench
from nlos.drivers.errors import DeviceFault, LimitError
from nlos.drivers.first_light_settings import FirstLightSettings
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, PointGates

log = logging.getLogger(__name__)

SPEED_OF_LIGHT_M_PER_S = 299_792_458.0
_AXES = ((1024, 16.0), (1024, 32.0), (1024, 20.0), (1024, 40.0), (1024, 64.0), (1024, 80.0))
_GRACE_S = 2.0
_HALF_WINDOW_S = 0.6e-9
_PART_OF_HIGHEST = 0.3
_PARTS = 32
"""Of the axis; their median is the background, however few counts there are and wherever light comes."""
_FAINT = 10
"""Photons in a peak below which there is none."""
_A_LITTLE_MORE = 1.1


def axis_of(bench: Bench) -> HistogramAxis:
    """A time axis that this counter can take, from just before the wall's direct light, as far as its delay is known.
    Raises `LimitError`."""
    arrival_ns = expected_s(bench, bench.settings.geometry.wall_distance_m) * 1e9
    refused: LimitError | None = None
    for bins, width_ps in _AXES:
        offset_ns = max(0.0, (arrival_ns - 3.0) // 8 * 8)
        axis = HistogramAxis(bins, width_ps * 1e-12, offset_ns * 1e-9)
        try:
            bench.counter.check(axis, 8e-3)
        except LimitError as error:
            refused = error
            continue
        return axis
    assert refused is not None
    raise refused


def gates(bench: Bench, dwells_s: Sequence[float], number: int = 0, attempts: int = 1) -> list[Histogram]:
    """One gate after the other where the beam is; the counter must be configured. `number`: of the first one. Raises
    `DeviceFault` for a gate that no scan would keep, in each of so many `attempts`."""
    counter, left = bench.counter, attempts
    taken: list[Histogram] = []
    while len(taken) < len(dwells_s):
        dwells, first = dwells_s[len(taken) :], number + len(taken)
        counter.arm(PointGates(dwells, range(first, first + len(dwells))))
        for index, dwell_s in enumerate(dwells):
            counter.trigger()
            counter.wait_points(index + 1, timeout_s=dwell_s + _GRACE_S)
            (read,) = counter.read(index, 1)
            spoilt, left = read.flags & SPOILT, left - 1
            if spoilt and left == 0:
                remedy = "Check its cable; plug it into a port of its own."
                raise DeviceFault(counter.identity.model, f"a point came back as {spoilt.name}.", remedy)
            if spoilt:
                log.warning("a point came back as %s and is taken again", spoilt.name)
                counter.abort()
                break
            taken, left = [*taken, read], attempts
    return taken


@dataclass(frozen=True)
class Arrival:
    """When direct light arrives after the sync pulse, and how well that is known: seconds. `photons` of it, and counts
    of `background` among them."""

    time_s: float
    error_s: float
    photons: float
    background: float

    def longer(self, needed_s: float, parts: int) -> float:
        """How many times as long each of `parts` equal gates has to be, of which this is the sum, for light to be found
        in it for sure, and to be known within `needed_s`; 1 where they are long enough."""
        photons, background = self.photons / parts, self.background / parts
        times = max(1.0, parts * (self.error_s / needed_s) ** 2)
        while not _surely(photons * times, background * times):
            times *= _A_LITTLE_MORE
        return times


def arrival(counts: npt.NDArray[np.integer], axis: HistogramAxis, near_s: float, reach_s: float) -> Arrival | None:
    """The mean time of the first high peak within `reach_s` of `near_s`; None where nothing stands out."""
    time_s = axis.offset_s + (np.arange(len(counts)) + 0.5) * axis.bin_width_s
    background = float(np.median([part.mean() for part in np.array_split(counts, _PARTS)]))
    wide = max(1, round(_HALF_WINDOW_S / axis.bin_width_s))
    seen = np.where(np.abs(time_s - near_s) <= reach_s, counts - background, 0.0)
    sums = np.convolve(seen, np.ones(2 * wide + 1), mode="same")
    highest, chance = float(sums.max()), max(_FAINT, 5 * math.sqrt(background * (2 * wide + 1)))
    # The first peak, not the highest: a hidden surface may return more light than the wall's spot. Nor the first that
    # chance makes before a faint one.
    first = int(np.argmax(sums >= max(_PART_OF_HIGHEST * highest, min(chance, highest))))
    peak = first + int(np.argmax(sums[first : first + 2 * wide + 1]))
    window = slice(max(peak - wide, 0), peak + wide + 1)
    weight = counts[window] - background
    total = float(weight.sum())
    if total < max(_FAINT, 5 * math.sqrt(background * len(weight))):
        return None
    mean_s = float((weight * time_s[window]).sum()) / total
    # Every count has its chance, also those that are background: what is left without them may have no width at all.
    error_s = math.sqrt(float((counts[window] * (time_s[window] - mean_s) ** 2).sum())) / total
    floor_s = axis.bin_width_s / 3.5 / math.sqrt(total)
    return Arrival(mean_s, max(error_s, floor_s), total, background * len(weight))


def _surely(photons: float, background: float) -> bool:
    """Whether so many, five standard deviations fewer by chance, still stand out as `arrival` asks for."""
    return photons - 5 * math.sqrt(photons + background) >= max(_FAINT, 5 * math.sqrt(background))


def expected_s(bench: Bench, range_m: float) -> float:
    """After the sync pulse: there and back, and the delay that first light found; cables without it have no length."""
    found = first_light_of(bench)
    delay_s = 0.0 if found is None else found.delay_ns * 1e-9
    return (2 * range_m / SPEED_OF_LIGHT_M_PER_S + delay_s) % (1 / bench.settings.laser.repetition_hz)


def first_light_of(bench: Bench) -> FirstLightSettings | None:
    """What first light measured on this bench, with this counter."""
    return bench.settings.with_own_first_light(bench.counter.identity.name).first_light


def delay_unknown(bench: Bench) -> str:
    """What to do where direct light is not seen."""
    if first_light_of(bench) is None:
        return "Run `nlos calibrate --first-light`: it finds direct light wherever in the period it comes."
    return "Check laser, shutter and aim; run `nlos calibrate --first-light` again where a cable was changed."
