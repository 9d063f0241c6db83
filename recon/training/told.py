"""What a network that asks for it is told of the instrument's response."""

from collections.abc import Mapping

import torch
from torch import nn

from nlos.recon.method import takes_response


def told(network: nn.Module, batch: Mapping[str, torch.Tensor]) -> tuple[torch.Tensor, ...]:
    """The argument after counts and exposure: the response (B, K), where the network takes one and one is told."""
    response = batch.get("response")
    if response is None or not takes_response(network):
        return ()
    return () if bool((response.amax(dim=1) == 1).all()) else (response,)
