"""The estimate of noise of any kind that comes with NANO's weights: read, and tied to the weights it was fitted to."""

from functools import lru_cache

from nlos.recon.layers.any_noise import AnyNoise
from nlos.recon.weights.files import OWN_FOLDER, goes_with, put_weights, read_weights

ANY_NOISE = "nano.noise"  # safetensors; by another name, for it is no weights of a method


@lru_cache(maxsize=4)
def any_noise_for(weights: str | None) -> AnyNoise | None:
    """The network that was fitted to the photon statistics of these weights of NANO; None for others. Raises
    WeightsError."""
    path = OWN_FOLDER / ANY_NOISE
    if weights is None or not path.is_file() or not goes_with(path, weights):
        return None
    network = AnyNoise()
    put_weights(network, {name: x.float() for name, x in read_weights(path).tensors.items()}, str(path))
    return network.eval().requires_grad_(False)
