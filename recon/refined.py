"""The refinement that comes with NANO's weights: read, and tied to the weights whose pictures it learned from."""

from functools import lru_cache

from nlos.recon.layers.refinement import Correction
from nlos.recon.weights.files import OWN_FOLDER, goes_with, put_weights, read_weights

REFINEMENT = "nano.refinement"  # safetensors; by another name, for it is no weights of a method


@lru_cache(maxsize=4)
def correction_for(weights: str | None) -> Correction | None:
    """The network that was fitted to pictures made by these weights of NANO; None for others. Raises WeightsError."""
    path = OWN_FOLDER / REFINEMENT
    if weights is None or not path.is_file() or not goes_with(path, weights):
        return None
    correction = Correction()
    put_weights(correction, {name: x.float() for name, x in read_weights(path).tensors.items()}, str(path))
    return correction.eval().requires_grad_(False)
