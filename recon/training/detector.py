"""What a single-photon detector makes of a transient: counts with the noise, gaps and faults of real scans.

Everything is stated for 64-bit reproducibility from one random generator; a sample carries its own true noise.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import numpy.typing as npt
from pydantic import Field

from nlos.acquisition.transient import TimeAxis
from nlos.configs.settings import Settings
from nlos.recon.training.impulse_responses import UNTOLD, fitted
from nlos.recon.training.shapes import Array

NOISELESS_PEAK_COUNTS = 20_000.0
UNIFORM_NOISE_PEAK_COUNTS = 255.0
UNIFORM_NOISE_MOST = 10.0

Share = Annotated[float, Field(ge=0, le=1)]
NotBelow0 = Annotated[float, Field(ge=0)]


class DetectorSettings(Settings):
    """How often which condition occurs. `noiseless` and `uniform` exclude one another, so together they are at most 1;
    the rest has photon noise. All other shares are drawn beside these and beside each other."""

    peak_counts_least: Annotated[float, Field(gt=0)] = 0.4
    """Least mean over the wall of each point's highest bin."""
    peak_counts_most: Annotated[float, Field(gt=0)] = 200.0
    """Greatest mean over the wall of each point's highest bin."""
    noiseless: Share = 0.12
    """Share of samples without photon noise."""
    uniform: Share = 0.08
    """Share with the uniform noise U(0, 10) on a scale of 0 to 255."""
    sparse: Share = 0.30
    """Share scanned at a part of the points."""
    uneven_dwell: Share = 0.15
    """Share with dwells that differ."""
    sparsest_step: Annotated[int, Field(ge=2, le=32)] = 4
    """The sparsest scans keep one point in this many along each side: 2, 4 and, doubling, up to this."""
    swept: Share = 0.0
    """Of the scans of all points, share whose lines are swept: each point is a mean along a pixel of its row."""
    jitter_fwhm_most_ps: NotBelow0 = 120.0
    """Widest response of ordinary detectors."""
    slow: Share = 0.0
    """Share of slow detectors, whose response is drawn evenly over log from 20 ps to `slow_fwhm_most_ps`."""
    slow_fwhm_most_ps: Annotated[float, Field(ge=20, le=5000)] = 800.0
    """Widest response of slow detectors."""
    told: Share = 0.0
    """Share of samples whose response is told."""
    told_wrong: Share = 0.5
    """Of these, share told wrong: up to a fifth too wide or too narrow, half of them as a Gaussian without its tail."""
    dark_per_peak_most: NotBelow0 = 0.06
    """Most background per bin, dark and ambient, over the mean peak."""
    afterpulsing_most: Share = 0.03
    """Greatest probability of an afterpulse."""
    pile_up: Share = 0.10
    """Share with pile-up and dead time."""
    detections_per_pulse_most: NotBelow0 = 0.15
    """Most clicks per laser pulse where there is pile-up."""
    calibration_residue: Share = 0.20
    """Share with leftover offsets and a leftover direct tail."""


@dataclass(frozen=True)
class Measurement:
    """One simulated scan. Noise is per bin and relative to the mean peak of the signal: 0.1 is a tenth of the peak."""

    counts: npt.NDArray[np.uint16]  # (T, H, W)
    exposure: Array  # (H, W) relative dwell: mean 1 over measured points, 0 where nothing was measured
    background: float  # expected background counts per bin at exposure 1
    noise_level: float  # root mean square of the noise map over measured points
    noise_map: Array  # (H, W) standard deviation of counts over exposure; inf where nothing was measured
    condition: str
    response: Array  # (TAPS,) the response as it is told: shares a bin, the middle one on time; a lone 1: not told


def measure(
    transient: Array,
    time: TimeAxis,
    settings: DetectorSettings,
    rng: np.random.Generator,
    impulse_responses: Sequence[npt.NDArray[np.floating]] = (),
    poisson: Callable[[Array], Array] | None = None,
) -> Measurement:
    """A scan of `transient` (T, H, W) by a detector drawn from `settings`.

    `impulse_responses` are measured ones, sampled at the time axis' bin width: half of the samples then use one of
    them, the others a Gaussian with an exponential tail. `poisson` draws photons in place of `rng`.
    Raises ValueError for a transient without light.
    """
    condition, sparse = _choose(settings, rng)
    response, told = _responses(time, settings, rng, impulse_responses)
    signal = respond(transient, response)
    peak = float(signal.max(axis=0).mean())
    if not peak > 0:
        raise ValueError("the transient holds no light: the scene lies outside the time axis")
    signal = signal / np.float32(peak)
    residue = rng.random() < settings.calibration_residue
    if residue:
        signal = shift_points(signal, rng.normal(0, rng.uniform(0.05, 0.6), signal.shape[1:]))
    if settings.swept and rng.random() < settings.swept and not sparse:
        signal = swept(signal)
    exposure = _exposure(signal.shape[1:], settings, sparse, rng)
    if condition == "noiseless":
        grain = rng.uniform(0.03, 0.20)
        peaks = NOISELESS_PEAK_COUNTS / max(float(signal.max()), 1e-6)
        expected = peaks * signal * exposure
        noisy = expected * (1 + grain * rng.standard_normal(expected.shape, dtype=np.float32))
        counts = np.rint(np.maximum(noisy, 0))
        variance = (grain * expected) ** 2
        background, level = 0.0, peaks
    elif condition == "uniform":
        level = UNIFORM_NOISE_PEAK_COUNTS / float(signal.max())
        most = rng.uniform(0, UNIFORM_NOISE_MOST)
        expected = level * signal * exposure
        counts = np.rint(expected + most * rng.random(expected.shape, dtype=np.float32) * (exposure > 0))
        background, variance = most / 2, np.full_like(expected, most**2 / 12 + 1 / 12)
    else:
        level = float(np.exp(rng.uniform(np.log(settings.peak_counts_least), np.log(settings.peak_counts_most))))
        rate, background = _rates(level * signal, settings, rng)
        if residue:
            tail = np.exp(-np.arange(time.bins) / rng.uniform(2, 12)) * level * rng.uniform(0, 0.5)
            rate = rate + tail.astype(np.float32)[:, None, None]
        if rng.random() < settings.pile_up:
            rate = pile_up(rate, rng.uniform(0, settings.detections_per_pulse_most))
        variance = rate * exposure
        counts = (rng.poisson if poisson is None else poisson)(variance).astype(np.float32)
    scale = np.maximum(exposure, 1e-9) * level
    noise_map = np.where(exposure > 0, np.sqrt(variance.mean(axis=0)) / scale, np.inf).astype(np.float32)
    measured = noise_map[exposure > 0]
    return Measurement(
        counts=np.minimum(counts, np.iinfo(np.uint16).max).astype(np.uint16),
        exposure=exposure,
        background=float(background),
        noise_level=float(np.sqrt(np.mean(measured**2))),
        noise_map=noise_map,
        condition=condition + ("+sparse" if sparse else ""),
        response=told,
    )


def respond(signal: Array, impulse_response: npt.NDArray[np.floating]) -> Array:
    """`signal` (T, ...) convolved along time with a response (K,), K odd, whose middle is time 0; edges lose light."""
    reach = impulse_response.size // 2
    if impulse_response.size == 1:
        return signal
    padded = np.pad(signal, ((reach, reach), *((0, 0),) * (signal.ndim - 1)))
    out = np.zeros_like(signal)
    for k, tap in enumerate(impulse_response[::-1]):
        if tap > 1e-4:
            out += np.float32(tap) * padded[k : k + signal.shape[0]]
    return out


def shift_points(signal: Array, bins: npt.NDArray[np.floating]) -> Array:
    """Each wall point's histogram (T, H, W) delayed by its own fraction of a bin, |shift| clipped to one bin."""
    part = np.clip(bins, -1, 1).astype(np.float32)
    later = np.concatenate((np.zeros_like(signal[:1]), signal[:-1]))
    earlier = np.concatenate((signal[1:], np.zeros_like(signal[:1])))
    shifted = signal * (1 - np.abs(part)) + np.where(part > 0, later, earlier) * np.abs(part)
    return np.asarray(shifted, dtype=np.float32)


def swept(signal: Array) -> Array:
    """Histograms (T, H, W) of points that a mirror in motion passes: the mean along a pixel of each row.

    By the curvature of light between points: a mean over a pixel takes 1/24 of it, of what varies slowly, and twice as
    much of what changes from point to point; rendered scenes lie between.
    """
    beside = np.pad(signal, ((0, 0), (0, 0), (1, 1)), mode="edge")
    return np.asarray(0.875 * signal + 0.0625 * (beside[..., :-2] + beside[..., 2:]), dtype=np.float32)


def pile_up(rate: Array, detections_per_pulse: float) -> Array:
    """First-photon distortion: a bin is seen only if no earlier photon of the same pulse was (dead time > window).

    `rate` (T, H, W) holds expected counts; the brightest point is given `detections_per_pulse` detections. Coates 1968.
    """
    brightest = float(rate.sum(axis=0).max())
    if brightest <= 0 or detections_per_pulse <= 0:
        return rate
    per_pulse = rate * np.float32(detections_per_pulse / brightest)
    before = np.cumsum(per_pulse, axis=0) - per_pulse
    seen = np.exp(-before) * -np.expm1(-per_pulse)
    return np.asarray(seen * np.float32(brightest / detections_per_pulse), dtype=np.float32)


def _choose(settings: DetectorSettings, rng: np.random.Generator) -> tuple[str, bool]:
    draw, sparse = rng.random(), bool(rng.random() < settings.sparse)
    if draw < settings.noiseless:
        return "noiseless", sparse
    return ("uniform" if draw < settings.noiseless + settings.uniform else "noisy"), sparse


def _responses(
    time: TimeAxis,
    settings: DetectorSettings,
    rng: np.random.Generator,
    measured: Sequence[npt.NDArray[np.floating]],
) -> tuple[npt.NDArray[np.float64], Array]:
    """The detector's response (K,), and what is told of it (TAPS,)."""
    if not (settings.slow or settings.told):
        return _impulse_response(time, settings, rng, measured), UNTOLD
    fwhm_ps, share, decay_ps = rng.uniform(0, settings.jitter_fwhm_most_ps), 0.0, 150.0
    if rng.random() < settings.slow:
        fwhm_ps = float(np.exp(rng.uniform(np.log(20), np.log(settings.slow_fwhm_most_ps))))
    if rng.random() < 0.5:
        share, decay_ps = rng.uniform(0, 0.3), float(rng.uniform(0.5, 1.5) * max(fwhm_ps, 100.0))
    response = pulse(time, fwhm_ps, share, decay_ps)
    if rng.random() >= settings.told:
        return response, UNTOLD
    if rng.random() >= settings.told_wrong:
        return response, fitted(response)
    wrong = 1 + rng.uniform(-0.2, 0.2)
    if rng.random() < 0.5:
        share = 0.0
    return response, fitted(pulse(time, wrong * fwhm_ps, share, wrong * decay_ps))


def _impulse_response(
    time: TimeAxis,
    settings: DetectorSettings,
    rng: np.random.Generator,
    measured: Sequence[npt.NDArray[np.floating]],
) -> npt.NDArray[np.float64]:
    choice, fwhm_ps, tail, decay_ps = rng.random(2), rng.uniform(0, settings.jitter_fwhm_most_ps), 0.25, 150.0
    if measured and choice[0] < 0.5:
        given = np.asarray(measured[int(choice[1] * len(measured))], dtype=np.float64)
        given = given[: given.size - 1 + given.size % 2]
        return np.asarray(given / given.sum(), dtype=np.float64)
    return pulse(time, fwhm_ps, rng.uniform(0, tail) * (rng.random() < 0.5), decay_ps)


def pulse(time: TimeAxis, fwhm_ps: float, share: float, decay_ps: float) -> npt.NDArray[np.float64]:
    """Shares a bin (K,), K odd, time 0 in the middle: a Gaussian, and `share` of the light in an exponential tail."""
    bin_ps = time.bin_width_s * 1e12
    fine = 8
    reach = int(np.ceil((1.5 * fwhm_ps + 4 * decay_ps * (share > 0)) / bin_ps)) + 1
    t = (np.arange((2 * reach + 1) * fine) + 0.5) / fine * bin_ps - (reach + 0.5) * bin_ps
    sigma = max(fwhm_ps / 2.3548, bin_ps / fine)
    response = np.exp(-0.5 * (t / sigma) ** 2)
    response /= response.sum()
    after = np.where(t > 0, np.exp(-t / decay_ps), 0)
    response = (1 - share) * response + share * after / after.sum()
    return np.asarray(response.reshape(-1, fine).sum(axis=1), dtype=np.float64)


def _exposure(shape: tuple[int, ...], settings: DetectorSettings, sparse: bool, rng: np.random.Generator) -> Array:
    """Relative dwell (H, W), mean 1 over measured points."""
    rows, cols = shape
    exposure = np.ones((rows, cols), np.float32)
    if rng.random() < settings.uneven_dwell:
        trend = rng.normal(0, 0.4, 2)
        ramp = trend[0] * np.linspace(-1, 1, rows)[:, None] + trend[1] * np.linspace(-1, 1, cols)[None]
        exposure = np.exp(ramp + rng.normal(0, rng.uniform(0, 0.5), shape)).astype(np.float32)
    if sparse:
        steps = [2, 4]
        while 2 * steps[-1] <= settings.sparsest_step:
            steps.append(2 * steps[-1])
        step = int(rng.choice(steps))
        keep = np.zeros(shape, bool)
        if rng.random() < 0.6:
            keep[rng.integers(step) :: step, rng.integers(step) :: step] = True
        else:
            keep.ravel()[rng.choice(keep.size, keep.size // step**2, replace=False)] = True
        exposure[~keep] = 0
    return np.asarray(exposure / exposure[exposure > 0].mean(), dtype=np.float32)


def _rates(signal: Array, settings: DetectorSettings, rng: np.random.Generator) -> tuple[Array, float]:
    """Expected counts with afterpulses (a delayed, smeared echo) and a flat background; and that background."""
    peak = float(signal.max(axis=0).mean())
    background = peak * rng.uniform(0, settings.dark_per_peak_most)
    share = rng.uniform(0, settings.afterpulsing_most) * (rng.random() < 0.3)
    if share > 0:
        # Release times (tens of ns) exceed the window, so within it afterpulses of the pulse before form a ramp.
        echo = share * signal.sum(axis=0) / signal.shape[0]
        ramp = np.linspace(1.5, 0.5, signal.shape[0], dtype=np.float32)
        signal = signal + ramp[:, None, None] * echo
    return signal + np.float32(background), background
