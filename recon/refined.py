"""The refinement that comes with NANO's weights."""

from functools import lru_cache

from nlos.recon.layers.refinement import Correction
from nlos.recon.weights.companions import companion

REFINEMENT = "nano.refinement"


@lru_cache(maxsize=4)
def correction_for(weights: str | None) -> Correction | None:
    """The network that was fitted to pictures made by these weights of NANO; None for others. Raises WeightsError."""
    return companion(Correction, REFINEMENT, weights)
