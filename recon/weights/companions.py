"""Small networks that come with NANO's weights, each tied to the weights that it was fitted for."""

import copy
from collections.abc import Callable
from typing import TypeVar

from torch import nn

from nlos.recon.weights.files import OWN_FOLDER, goes_with, put_weights, read_weights

N = TypeVar("N", bound=nn.Module)
Shared = TypeVar("Shared")


def companion(make: Callable[[], N], name: str, weights: str | None) -> N | None:
    """The network in the file `name`, not `.safetensors` as it is no weights of a method, if it was fitted for these
    weights of NANO; None for others. Raises WeightsError."""
    path = OWN_FOLDER / name
    if weights is None or not path.is_file() or not goes_with(path, weights):
        return None
    network = make()
    put_weights(network, {key: x.float() for key, x in read_weights(path).tensors.items()}, str(path))
    return network.eval().requires_grad_(False)


def own_copy(shared: Shared | None) -> Shared | None:
    """Of what is kept for all: a network that moves to another device takes its own along, and no other's."""
    return copy.deepcopy(shared)
