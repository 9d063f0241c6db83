"""The conditions under which methods are evaluated: a dataset, a slower detector, fewer points."""

import re
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import convolve1d

from nlos.acquisition.response import gaussian
from nlos.acquisition.transient import Transient
from nlos.recon.errors import InvalidData, InvalidSettings

NOISELESS = "transient"
SEED = 0


@dataclass(frozen=True)
class Condition:
    """`DATASET`, `DATASET~300ps`, either with `@RxC` or `@blue:N`."""

    dataset: str
    fwhm_ps: float | None
    """Of a response by which the noiseless transient is spread before its photons are drawn."""
    subset: str

    @property
    def needed(self) -> set[str]:
        """The datasets that a scene must have."""
        return {self.dataset} | ({NOISELESS} if self.fwhm_ps is not None else set())


def parsed(words: str) -> Condition:
    """Raises `InvalidSettings` for a response that is no number of picoseconds."""
    whole, _, subset = words.partition("@")
    dataset, slow, response = whole.partition("~")
    if not slow:
        return Condition(dataset, None, subset)
    found = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)ps", response)
    if found is None or not 1 <= float(found[1]) <= 25_000:
        raise InvalidSettings(f"condition {words}: ~{response} is no response; as in {dataset}~300ps, 1 to 25000 ps")
    return Condition(dataset, float(found[1]), subset)


def slowed(drawn: Transient, noiseless: Transient, fwhm_ps: float) -> Transient:
    """As many photons and as much background as `drawn` has, drawn (seed 0) from `noiseless` as a detector with a
    Gaussian response of that width records it; and that response. Raises `InvalidData` for transients without light.

    Photons and background follow from a straight line through the mean histograms.
    """
    clean = noiseless.counts.mean(axis=(1, 2), dtype=np.float64)
    seen = drawn.counts.mean(axis=(1, 2), dtype=np.float64)
    light = float(noiseless.counts.sum(dtype=np.float64))
    if not (light > 0 and clean.std() > 0):
        raise InvalidData("the noiseless transient holds no light")
    background = max(float(np.polyfit(clean, seen, 1)[1]), 0.0)
    photons = max(float(drawn.counts.sum(dtype=np.float64)) - background * drawn.counts.size, 0.0)
    response = gaussian(fwhm_ps * 1e-12, f"the condition's Gaussian of {fwhm_ps:g} ps")
    taps = response.taps(drawn.time.bin_width_s)
    spread = convolve1d(noiseless.counts.astype(np.float64), taps, axis=0, mode="constant")
    expected = np.maximum(photons / light * spread + background, 0)
    counts = np.random.default_rng(SEED).poisson(expected).astype(np.float32)
    return replace(drawn, counts=counts, response=response)
