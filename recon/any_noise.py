"""The estimate of noise of any kind that comes with NANO's weights."""

from functools import lru_cache

from nlos.recon.layers.any_noise import AnyNoise
from nlos.recon.weights.companions import companion

ANY_NOISE = "nano.noise"


@lru_cache(maxsize=4)
def any_noise_for(weights: str | None) -> AnyNoise | None:
    """The network that was fitted to the photon statistics of these weights of NANO; None for others. Raises
    WeightsError."""
    return companion(AnyNoise, ANY_NOISE, weights)
