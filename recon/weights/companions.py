"""Small networks that come with NANO's weights, each tied to the weights that it was fitted for."""

from collections.abc import Callable
from typing import TypeVar

from torch import nn

from nlos.recon.weights.files import OWN_FOLDER, goes_with, put_weights, read_weights

N = TypeVar("N", bound=nn.Module)


def companion(make: Callable[[], N], name: str, weights: str | None) -> N | None:
    """The network in the file `name`, not `.safetensors` as it is no weights of a method, if it was fitted for these
    weights of NANO; None for others. Raises WeightsError."""
    path = OWN_FOLDER / name
    if weights is None or not path.is_file() or not goes_with(path, weights):
        return None
    network = make()
    put_weights(network, {key: x.float() for key, x in read_weights(path).tensors.items()}, str(path))
    return network.eval().requires_grad_(False)
