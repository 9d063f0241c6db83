"""The noise level from evanescent waves: frequencies that no scene can light up hold noise alone, of whatever kind.

Confocal light obeys f^2 = (c / 2)^2 (kx^2 + ky^2 + kz^2), so below f = c / 2 |k| a scan has no light of any scene, but
its share of the noise, which is white in time and over the wall: photons, uniform noise and grain alike. A way to what
the trained estimation lacks; needs every point of a grid. `python -m studies.evanescent_noise` measures it.
"""

import numpy as np
import numpy.typing as npt
import torch

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.recon.layers.rates import rates_of
from nlos.recon.training.dataset import sample
from nlos.recon.training.training_sample import collate
from studies.noise_figure import KINDS, NoiseFit, held_out

INSIDE = 0.5  # of the light cone: farther from it than what leaks through the wall's tapered edges
FINE = 0.5  # of the largest wall frequency; coarser ones have few time frequencies below the cone
SCENES = 25
VARIANCE_GOES_WITH = {"photons": 1, "uniform": 0, "grain": 2}  # which power of the rate
Cube = npt.NDArray[np.float32] | npt.NDArray[np.float64]


def noise_variance(rates: Cube, pitch_m: tuple[float, float], bin_width_s: float, power: int) -> float:
    """Mean variance of one bin of rates (T, H, W) measured every `pitch_m` (y, x), of noise whose variance goes with
    the rate to this `power`. The wall's edges are tapered, and the variance there is brought to the whole scan's.

    Raises ValueError where no frequency lies far enough below the cone: too short a scan, or too coarse a grid.
    """
    bins, rows, cols = rates.shape
    taper = np.hanning(rows + 2)[1:-1, None] * np.hanning(cols + 2)[1:-1]
    mean = float((rates * taper).sum() / (taper.sum() * bins))
    density = np.abs(np.fft.rfftn((rates - mean) * taper)) ** 2 / (np.square(taper).sum() * bins)
    f = np.abs(np.fft.fftfreq(bins, bin_width_s))[:, None, None]
    k = np.hypot(np.fft.fftfreq(rows, pitch_m[0])[:, None], np.fft.rfftfreq(cols, pitch_m[1]))[None]
    below = (f < INSIDE * SPEED_OF_LIGHT_M_PER_S / 2 * k - 1.5 / (bins * bin_width_s)) & (k > FINE * k.max())
    if not below.any():
        raise ValueError(f"{bins} bins of {bin_width_s:g} s and {rows} x {cols} points have no evanescent frequencies")
    weight = np.square(taper) / np.square(taper).mean()
    level = np.clip(rates, 0, None) ** power
    return float(np.median(density[below]) / np.log(2) * level.mean() / (weight * level).mean())


def measured(kind: str, scenes: int = SCENES) -> NoiseFit:
    """True and estimated log10 noise level of whole scans of held-out kinds; the signal's peak is the scan's own."""
    detector = KINDS[kind].model_copy(update={"sparse": 0.0})
    data = held_out(detector, scenes)
    pitch_m = data.wall.height_m / data.wall.rows, data.wall.width_m / data.wall.cols
    true, estimated = [], []
    for index in range(scenes):
        batch = collate([sample(data, index)])
        rates = rates_of(batch["counts"], batch["exposure"])
        cube = rates.raw[0, 0]
        smooth = torch.nn.functional.avg_pool3d(cube[None, None], 3, stride=1, padding=1, count_include_pad=False)[0, 0]
        peak = float((smooth if kind == "photons" else cube).amax(dim=0).mean()) - float(rates.background[0])
        variance = noise_variance(cube.numpy(), pitch_m, data.time.bin_width_s, VARIANCE_GOES_WITH[kind])
        true.append(float(batch["noise_level"].log10()))
        estimated.append(0.5 * float(np.log10(variance)) - float(np.log10(max(peak, 1e-12))))
    return NoiseFit(np.asarray(true), np.asarray(estimated))


if __name__ == "__main__":
    for name in KINDS:
        fit = measured(name)
        print(f"{name}: R^2 {fit.r_squared:.3f}, bias {fit.bias:+.3f}, scatter {fit.scatter:.3f} decades", flush=True)
