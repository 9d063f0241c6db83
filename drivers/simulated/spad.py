"""A single-photon detector: timing jitter, dark counts, dead time, afterpulsing, and counts drawn from the rates."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from pydantic import Field

from nlos.configs.settings import Settings
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.afterpulses import Afterpulses
from nlos.drivers.simulated.bench import Exposure, Gate
from nlos.drivers.simulated.turns import placed

Array = npt.NDArray[np.float64]

FWHM_PER_SIGMA = 2.3548200450309493


class DetectorSettings(Settings):
    """A thin-junction SPAD with its electronics; jitter includes the laser pulse."""

    jitter_fwhm_ps: float = Field(default=70.0, gt=0)
    """Full width at half maximum of the response, laser pulse included."""
    tail_fraction: float = Field(default=0.05, ge=0, lt=1)
    """Part of the detections that are late by an exponential diffusion tail."""
    tail_ps: float = Field(default=100.0, gt=0)
    """Time constant of the diffusion tail."""
    dark_cps: float = Field(default=100.0, ge=0)
    """Clicks in the dark."""
    dead_time_ns: float = Field(default=77.0, ge=0)
    """Blind after a click."""
    afterpulse_probability: float = Field(default=0.0, ge=0, lt=0.5)
    """Of a click being followed by one without a photon."""
    afterpulse_ns: float = Field(default=30.0, gt=0)
    """Time constant of afterpulses, counted from the end of the dead time."""


class Response:
    """The detector's impulse response: a Gaussian, part of it delayed exponentially."""

    def __init__(self, settings: DetectorSettings) -> None:
        sigma_s = settings.jitter_fwhm_ps * 1e-12 / FWHM_PER_SIGMA
        tail_s = settings.tail_ps * 1e-12 if settings.tail_fraction else sigma_s
        step_s = min(sigma_s, tail_s) / 16
        before, after = int(5 * sigma_s / step_s), int((5 * sigma_s + 9 * tail_s) / step_s)
        time_s = np.arange(-before, after + 1) * step_s
        prompt = np.exp(-0.5 * (time_s / sigma_s) ** 2)
        prompt /= prompt.sum()
        decay = np.exp(-np.arange(len(time_s)) * step_s / tail_s)
        late = np.convolve(prompt, decay / decay.sum())[: len(time_s)]
        density = (1 - settings.tail_fraction) * prompt + settings.tail_fraction * late
        self._edges_s = np.append(time_s, time_s[-1] + step_s) - step_s / 2
        self._cumulative = np.append(0.0, np.cumsum(density) / density.sum())
        self._kernels: dict[float, tuple[int, Array]] = {}

    def pulse(self, arrival: float, bin_width_s: float) -> tuple[int, Array]:
        """First bin and the fraction of one pulse in each; the pulse arrives `arrival` bins after bin 0's start."""
        first = int(np.floor(arrival + self._edges_s[0] / bin_width_s))
        last = int(np.ceil(arrival + self._edges_s[-1] / bin_width_s))
        edges_s = (np.arange(first, last + 1) - arrival) * bin_width_s
        return first, np.diff(np.interp(edges_s, self._edges_s, self._cumulative))

    def kernel(self, bin_width_s: float) -> tuple[int, Array]:
        """The same for light at the centre of bin 0: what a sampled rate is convolved with."""
        if bin_width_s not in self._kernels:
            first, fractions = self.pulse(0.5, bin_width_s)
            keep = np.flatnonzero(fractions > 1e-7)
            self._kernels[bin_width_s] = (first + int(keep[0]), fractions[keep[0] : keep[-1] + 1])
        return self._kernels[bin_width_s]


def distort(per_pulse: Array, bin_width_s: float, settings: DetectorSettings) -> Array:
    """Expected detections per laser pulse of a free-running detector with dead time and afterpulsing.

    `per_pulse` (P,) are expected photons over one whole laser period. Bin b detects mu_b (1 - sum of the detections
    within the preceding dead time, cyclically), the steady state whose inverse is Coates' correction for a
    free-running detector (Coates 1968, with the sum over the dead time instead of the start of the period); and the
    afterpulses of earlier detections for which it is live.
    """
    period = len(per_pulse)
    dead = round(settings.dead_time_ns * 1e-9 / bin_width_s)
    share, again = settings.afterpulse_probability, np.zeros(1)
    if dead == 0 and not share:
        return per_pulse
    after = Afterpulses(per_pulse, dead, settings.afterpulse_ns * 1e-9 / bin_width_s) if share else None
    wanted = -np.expm1(-per_pulse) if dead else per_pulse
    load = float(wanted.sum()) * dead / period
    step = 1.0 if load < 0.3 else 1 / (1 + load)
    detected: Array = wanted / (1 + load)
    for number in range(200):
        live = np.clip(1 - _preceding(detected, dead), 0, 1)  # of many photons a pulse, a step may overshoot
        settled = after is None or number % 4 == 0  # afterpulses hardly change from step to step
        if after is not None and settled:
            again = share * after.of(detected, live)
        change = step * (wanted * live + again - detected)
        detected = detected + change
        # Each step leaves about `load` of the last change as the error, and `share` of it as afterpulses to come.
        if settled and min(load + share, 1.0) * np.abs(change).max() <= 1e-5 * detected.max():
            break
    return detected


def _preceding(detected: Array, dead: int) -> Array:
    """Detections in the `dead` bins up to the middle of each bin, cyclically, (P,): half of those in the earliest bin,
    none of those in the bin itself."""
    period = len(detected)
    turns, rest = divmod(dead, period)
    until = np.append(0.0, np.cumsum(detected))
    total = until[-1]
    result: Array = until[:period] + turns * total
    result[rest:] -= until[: period - rest]
    result[:rest] += total - until[period - rest : period]
    return result - np.roll(detected, dead) / 2 if dead else result


def draw(per_pulse: Array, gate: Gate, repetition_hz: float, rng: np.random.Generator) -> Exposure:
    """Poisson counts in `gate` from expected detections per pulse (P,), a whole period that starts with the gate."""
    pulses = gate.dwell_s * repetition_hz
    window = per_pulse[: gate.bins]
    counts = rng.poisson(window * pulses).astype(np.uint32)
    if gate.bins > len(window):
        counts = np.pad(counts, (0, gate.bins - len(window)))
    outside = int(rng.poisson(max(0.0, float(per_pulse.sum() - window.sum())) * pulses))
    exposure = Exposure(counts, gate.dwell_s, round(pulses), int(counts.sum()) + outside, False)
    return stop_at_counts(exposure, gate, rng)


def stop_at_counts(exposure: Exposure, gate: Gate, rng: np.random.Generator) -> Exposure:
    """The exposure as it was when the gate's window had collected `stop_counts`, if it ever had.

    Of n arrivals spread evenly over the dwell the k-th comes at the dwell times Beta(k, n - k + 1); what had arrived
    elsewhere by then is a binomial part, and which k of the n were in is a draw without replacement.
    """
    first, last = gate.stop_window or (0, gate.bins)
    inside = exposure.counts[first:last]
    arrived = int(inside.sum())
    if not 0 < gate.stop_counts <= arrived:
        return exposure
    part = float(rng.beta(gate.stop_counts, arrived - gate.stop_counts + 1))
    counts = rng.binomial(exposure.counts, part).astype(np.uint32)
    counts[first:last] = rng.multivariate_hypergeometric(inside.astype(np.int64), gate.stop_counts, method="marginals")
    outside = int(rng.binomial(exposure.total_count - int(exposure.counts.sum()), part))
    return replace(
        exposure,
        counts=counts,
        live_s=exposure.live_s * part,
        sync_count=round(exposure.sync_count * part),
        total_count=int(counts.sum()) + outside,
        stopped_early=True,
    )


def arrivals(exposure: Exposure, rng: np.random.Generator) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """The exposure as a list of photons in order of arrival: (laser pulse number since the gate opened, time bin).

    A Poisson process conditional on its histogram: bins as counted, pulses uniform. Decoding the list gives the same
    histogram again, so that list mode and histogram mode measure the same photons.
    """
    bins = np.repeat(np.arange(len(exposure.counts)), exposure.counts)
    pulses = rng.integers(0, max(1, exposure.sync_count), size=len(bins))
    order = np.lexsort((bins, pulses))
    return pulses[order], bins[order]


def generator(seed: int, gate: Gate, beam: MirrorAngles, salt: int = 0) -> np.random.Generator:
    """The random stream of one gate: from (seed, number, piece); without a number from (seed, beam position, dwell,
    turn)."""
    if gate.number is not None:
        return np.random.default_rng((seed, salt, 0, gate.number, *_unless_first(gate.piece)))
    return np.random.default_rng((seed, salt, 1, *placed(beam, gate.dwell_s), *_unless_first(gate.turn or 0)))


def _unless_first(index: int) -> tuple[int, ...]:
    return (index,) if index else ()
